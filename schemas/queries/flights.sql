-- Every flight in a row: when, how much of it is usable, how much was detected, what is odd.
SELECT left(flight_id, 16)                   AS flight,
       parse_filename(source_uri)            AS recording,
       start_utc,
       round(duration_s, 1)                  AS duration_s,
       n_frames,
       round(100 * frame_coverage, 1)        AS usable_percent,
       round(100 * detection_coverage, 1)    AS detected_percent,
       round(100 * span_coverage, 1)         AS spans_percent,
       n_anomalies,
       n_open_anomalies
FROM flight_summary
ORDER BY start_utc

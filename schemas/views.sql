-- Views for everyday questions. Not frozen: recreated in indexes of other versions of the program.

DROP VIEW IF EXISTS sensor_dropouts; -- frame_dropouts took its place

CREATE OR REPLACE VIEW flight_summary AS
WITH frame_stats AS (
    SELECT flight_id,
           count(*) FILTER (n_segments > 0)  AS n_frames_with_segments,
           count(*) FILTER (n_lines > 0)     AS n_frames_with_lines,
           median(sharpness)                 AS median_sharpness,
           median(infer_ms)                  AS median_infer_ms
    FROM frames
    GROUP BY flight_id
),
channel_stats AS (
    SELECT flight_id, count(*) AS n_channels
    FROM channels
    GROUP BY flight_id
),
coverages AS (
    SELECT flight_id,
           max(share) FILTER (kind = 'frame')                      AS frame_coverage,
           max(share) FILTER (kind = 'detection' AND unit = 's')   AS detection_coverage,
           -- of the spans of which at least half was passed within near_m
           sum(covered) FILTER (kind = 'span' AND passed >= total / 2)
             / nullif(sum(total - unknown) FILTER (kind = 'span' AND passed >= total / 2), 0)
                                                                   AS span_coverage,
           max(share) FILTER (kind = 'corridor')                   AS corridor_coverage
    FROM coverage
    WHERE channel_id IS NULL
    GROUP BY flight_id
),
anomaly_stats AS (
    SELECT a.flight_id,
           count(*)                                  AS n_anomalies,
           count(*) FILTER (r.anomaly_id IS NULL)    AS n_open_anomalies
    FROM anomalies AS a
    LEFT JOIN reviews AS r USING (anomaly_id)
    GROUP BY a.flight_id
)
SELECT f.flight_id,
       f.source_uri,
       f.status,
       f.start_utc,
       f.end_utc,
       (f.end_ns - f.start_ns) / 1e9                                   AS duration_s,
       coalesce(c.n_channels, 0)                                       AS n_channels,
       f.n_frames,
       f.n_bad_frames,
       coalesce(s.n_frames_with_segments, 0)                           AS n_frames_with_segments,
       coalesce(s.n_frames_with_lines, 0)                              AS n_frames_with_lines,
       s.n_frames_with_segments / nullif(f.n_frames - f.n_bad_frames, 0) AS detection_share,
       v.frame_coverage,
       v.detection_coverage,
       v.span_coverage,
       v.corridor_coverage,
       coalesce(a.n_anomalies, 0)                                      AS n_anomalies,
       coalesce(a.n_open_anomalies, 0)                                 AS n_open_anomalies,
       f.n_segments,
       f.n_lines,
       s.median_sharpness,
       s.median_infer_ms,
       m.name                                                          AS model_name,
       f.ingested_at
FROM flights AS f
LEFT JOIN frame_stats AS s USING (flight_id)
LEFT JOIN channel_stats AS c USING (flight_id)
LEFT JOIN coverages AS v USING (flight_id)
LEFT JOIN anomaly_stats AS a USING (flight_id)
LEFT JOIN models AS m USING (model_id);

CREATE OR REPLACE VIEW bad_frames AS
SELECT f.flight_id, f.channel_id, c.topic, f.frame_idx, f.log_time_ns, f.log_time_utc, f.reason
FROM frames AS f
LEFT JOIN channels AS c USING (flight_id, channel_id)
WHERE f.status = 'bad';

CREATE OR REPLACE VIEW frame_dropouts AS
SELECT flight_id,
       channel_id,
       first_frame_idx AS frame_before,
       last_frame_idx  AS frame_after,
       start_ns,
       start_utc,
       duration_s      AS gap_s,
       length_m        AS gap_m,
       n_frames        AS n_frames_lost
FROM coverage_gaps
WHERE kind = 'frame';

CREATE OR REPLACE VIEW detection_gaps AS
SELECT flight_id,
       channel_id,
       first_frame_idx,
       last_frame_idx,
       n_frames,
       start_ns,
       start_utc,
       duration_s,
       length_m
FROM coverage_gaps
WHERE kind = 'detection';

CREATE OR REPLACE VIEW span_coverage AS
WITH bins AS (
    SELECT flight_id,
           span_id,
           max(best_gsd_m) AS worst_gsd_m,
           min(n_frames)   AS least_frames,
           min(first_ns)   AS first_ns,
           max(last_ns)    AS last_ns
    FROM coverage_bins
    WHERE kind = 'span'
    GROUP BY flight_id, span_id
)
SELECT c.flight_id,
       c.span_id,
       s.line_id,
       c.total         AS length_m,
       c.imaged        AS imaged_m,
       c.covered       AS covered_m,
       c.share,
       c.unknown       AS unknown_m,
       c.reason,
       c.passed        AS passed_m,
       c.longest_gap_m,
       b.worst_gsd_m,
       b.least_frames,
       b.first_ns,
       make_timestamp(b.first_ns // 1000) AS first_utc,
       b.last_ns,
       make_timestamp(b.last_ns // 1000)  AS last_utc,
       c.thresholds
FROM coverage AS c
LEFT JOIN bins AS b USING (flight_id, span_id)
LEFT JOIN spans AS s USING (span_id)
WHERE c.kind = 'span' AND c.span_id IS NOT NULL;

-- What each rule about conductors could say about a span: metres judged, and the commonest reason why not.
CREATE OR REPLACE VIEW span_judged AS
SELECT flight_id,
       span_id,
       kind,
       sum(length_m)                                                  AS length_m,
       coalesce(sum(length_m) FILTER (outcome = 'judged'), 0)         AS judged_m,
       arg_max(outcome, length_m) FILTER (outcome <> 'judged')        AS why_not
FROM span_judgements
GROUP BY flight_id, span_id, kind;

CREATE OR REPLACE VIEW corridor_coverage AS
SELECT flight_id,
       total   AS length_m,
       imaged  AS imaged_m,
       covered AS covered_m,
       share,
       unknown AS unknown_m,
       reason,
       longest_gap_m,
       thresholds
FROM coverage
WHERE kind = 'corridor';

-- Over all flights: a bin is covered when any of them covered it.
CREATE OR REPLACE VIEW span_last_seen AS
WITH bins AS (
    SELECT span_id,
           bin_idx,
           any_value(length_m) AS length_m,
           max(n_detected) > 0 AS is_covered
    FROM coverage_bins
    WHERE kind = 'span'
    GROUP BY span_id, bin_idx
),
unions AS (
    SELECT span_id, sum(length_m) FILTER (is_covered) AS covered_m, sum(length_m) AS length_m
    FROM bins
    GROUP BY span_id
),
flown AS (
    SELECT span_id,
           count(*) FILTER (covered_m > 0) AS n_flights,
           max(last_ns)                    AS last_ns,
           arg_max(flight_id, last_ns)     AS last_flight_id
    FROM span_coverage
    GROUP BY span_id
)
SELECT s.span_id,
       s.line_id,
       s.length_m,
       coalesce(u.covered_m, 0)               AS covered_m,
       coalesce(u.covered_m / u.length_m, 0)  AS share,
       coalesce(f.n_flights, 0)               AS n_flights,
       f.last_ns,
       make_timestamp(f.last_ns // 1000)      AS last_utc,
       f.last_flight_id
FROM spans AS s
LEFT JOIN unions AS u USING (span_id)
LEFT JOIN flown AS f USING (span_id);

CREATE OR REPLACE VIEW unseen_spans AS
SELECT span_id, line_id, length_m
FROM span_last_seen
WHERE n_flights = 0;

CREATE OR REPLACE VIEW reviewed_anomalies AS
SELECT a.*,
       coalesce(r.verdict, 'open') AS verdict,
       r.note,
       r.reviewed_at,
       nullif(r.reviewed_by, '') AS reviewed_by
FROM anomalies AS a
LEFT JOIN reviews AS r USING (anomaly_id);

-- What flights say of spans, to be compared between them: numbers of conductors and of anomalies where the rule
-- judged at least half of the span, and the sag of each conductor. A number of conductors is known only where each of
-- them was judged.
CREATE OR REPLACE VIEW span_states AS
WITH counted AS (
    SELECT flight_id,
           span_id,
           count(DISTINCT conductor)                                                     AS n_conductors,
           count(DISTINCT conductor) FILTER (present_m >= judged_m / 2)                  AS n_present,
           bool_and(judged_m > 0)                                                        AS is_known
    FROM conductors
    GROUP BY flight_id, span_id
),
judged AS (
    SELECT flight_id, span_id, kind
    FROM span_judged
    WHERE judged_m >= length_m / 2
),
crossings AS (
    SELECT a.anomaly_id,
           a.flight_id,
           arg_min(b.span_id, pow(a.lat_deg - b.lat_deg, 2) + pow(a.lon_deg - b.lon_deg, 2)) AS span_id
    FROM anomalies AS a
    JOIN coverage_bins AS b ON a.flight_id = b.flight_id AND b.kind = 'span' AND b.n_detected > 0
    WHERE a.kind = 'crossing_line'
    GROUP BY a.anomaly_id, a.flight_id
),
states AS (
    SELECT j.flight_id, j.span_id, 'conductors' AS subject, NULL::INTEGER AS conductor, n_present::DOUBLE AS value,
           NULL::DOUBLE AS sd
    FROM judged AS j
    JOIN counted USING (flight_id, span_id)
    WHERE j.kind = 'conductor_count' AND is_known
    UNION ALL
    SELECT flight_id, span_id, 'sag_m', conductor, avg(sag_m), max(sag_sd_m)
    FROM conductors
    WHERE sag_m IS NOT NULL
    GROUP BY flight_id, span_id, conductor
    UNION ALL
    SELECT j.flight_id, j.span_id, j.kind, NULL, count(a.anomaly_id), NULL
    FROM judged AS j
    LEFT JOIN anomalies AS a USING (flight_id, span_id, kind)
    GROUP BY j.flight_id, j.span_id, j.kind
    UNION ALL
    SELECT v.flight_id, v.span_id, 'crossing_line', NULL, count(c.anomaly_id), NULL
    FROM span_coverage AS v
    LEFT JOIN crossings AS c USING (flight_id, span_id)
    WHERE v.covered_m >= v.length_m / 2
    GROUP BY v.flight_id, v.span_id
)
SELECT s.flight_id, f.start_ns, s.span_id, s.subject, s.conductor, s.value, s.sd, c.n_conductors
FROM states AS s
JOIN flights AS f USING (flight_id)
LEFT JOIN counted AS c USING (flight_id, span_id);

-- Answers that are asked for every day. Not frozen: made anew at every publish.

CREATE OR REPLACE VIEW flight_summary AS
WITH frame_stats AS (
    SELECT flight_id,
           count(*) FILTER (n_segments > 0)  AS n_frames_with_segments,
           median(sharpness)                 AS median_sharpness,
           median(infer_ms)                  AS median_infer_ms
    FROM frames
    GROUP BY flight_id
),
channel_stats AS (
    SELECT flight_id, count(*) AS n_channels
    FROM channels
    GROUP BY flight_id
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
       s.n_frames_with_segments / nullif(f.n_frames - f.n_bad_frames, 0) AS detection_share,
       f.n_segments,
       f.n_lines,
       s.median_sharpness,
       s.median_infer_ms,
       m.name                                                          AS model_name,
       f.ingested_at
FROM flights AS f
LEFT JOIN frame_stats AS s USING (flight_id)
LEFT JOIN channel_stats AS c USING (flight_id)
LEFT JOIN models AS m USING (model_id);

CREATE OR REPLACE VIEW bad_frames AS
SELECT f.flight_id, f.channel_id, c.topic, f.frame_idx, f.log_time_ns, f.log_time_utc, f.reason
FROM frames AS f
LEFT JOIN channels AS c USING (flight_id, channel_id)
WHERE f.status = 'bad';

-- Frames that did not come: intervals over 2.5 times the channel's median.
CREATE OR REPLACE VIEW sensor_dropouts AS
WITH intervals AS (
    SELECT flight_id,
           channel_id,
           lag(frame_idx) OVER following AS frame_before,
           frame_idx                     AS frame_after,
           lag(log_time_ns) OVER following AS start_ns,
           log_time_ns                   AS end_ns,
           log_time_ns - lag(log_time_ns) OVER following AS gap_ns
    FROM frames
    WINDOW following AS (PARTITION BY flight_id, channel_id ORDER BY frame_idx)
),
medians AS (
    SELECT flight_id, channel_id, median(gap_ns) AS median_ns
    FROM intervals
    GROUP BY flight_id, channel_id
)
SELECT flight_id,
       channel_id,
       frame_before,
       frame_after,
       start_ns,
       make_timestamp(start_ns // 1000)           AS start_utc,
       gap_ns / 1e9                               AS gap_s,
       round(gap_ns / median_ns)::BIGINT - 1      AS n_frames_lost
FROM intervals
JOIN medians USING (flight_id, channel_id)
WHERE gap_ns > 2.5 * median_ns;

-- Five or more good frames in a row without any segment; bad frames neither count nor interrupt.
CREATE OR REPLACE VIEW detection_gaps AS
WITH numbered AS (
    SELECT flight_id,
           channel_id,
           frame_idx,
           log_time_ns,
           n_segments > 0 AS has_segments,
           row_number() OVER (PARTITION BY flight_id, channel_id ORDER BY frame_idx)
             - row_number() OVER (PARTITION BY flight_id, channel_id, n_segments > 0 ORDER BY frame_idx) AS streak
    FROM frames
    WHERE status = 'ok'
)
SELECT flight_id,
       channel_id,
       min(frame_idx)                                  AS first_frame,
       max(frame_idx)                                  AS last_frame,
       count(*)                                        AS n_frames,
       min(log_time_ns)                                AS start_ns,
       make_timestamp(min(log_time_ns) // 1000)        AS start_utc,
       (max(log_time_ns) - min(log_time_ns)) / 1e9     AS duration_s
FROM numbered
WHERE NOT has_segments
GROUP BY flight_id, channel_id, streak
HAVING count(*) >= 5;

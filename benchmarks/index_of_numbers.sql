-- An index of $flights flights made of numbers: 1,000 frames, 10,000 segments and 4,000 lines each.
CREATE TEMP TABLE f AS SELECT i, sha256(i::VARCHAR) AS flight_id, 1767225600000000000 + i * 3600000000000 AS t
FROM range($flights) AS r(i);
INSERT INTO models VALUES ('m', 'fast', 'fast', 'x', 0.5);
INSERT INTO runs (run_id, started_at, host, app_version, config_sha256, config)
VALUES ('00000000-0000-0000-0000-000000000001', '2026-01-01', 'h', '0.1.0', 'x', '{}');
INSERT INTO flights BY NAME
SELECT flight_id, 'file:///inbox/' || i || '.mcap' AS source_uri, 1000 AS source_bytes, 'm' AS model_id,
       '00000000-0000-0000-0000-000000000001' AS run_id, 'x' AS config_sha256, 'ok' AS status, t AS start_ns,
       t + 1000 * 250_000_000::BIGINT AS end_ns, 1000 AS n_frames, 1 AS n_bad_frames,
       10000 AS n_segments, 4000 AS n_lines, '2026-01-01' AS ingested_at,
       'x' AS result_sha256 FROM f;
INSERT INTO channels BY NAME
SELECT flight_id, 1 AS channel_id, '/camera' AS topic, 'x' AS schema_name, 'protobuf' AS message_encoding FROM f;
INSERT INTO frames BY NAME
SELECT flight_id, 1 AS channel_id, n AS frame_idx, t + n * 250_000_000::BIGINT AS log_time_ns,
       t + n * 250_000_000::BIGINT AS stamp_ns, 1280 AS width, 720 AS height, if(n = 7, 'bad', 'ok') AS status,
       if(n = 7, 'corrupt JPEG', NULL) AS reason, 100 + hash(n, i) % 400 AS sharpness, 100 AS mean_luma,
       10 AS n_segments, 4 AS n_lines, hash(n) % 40 AS infer_ms, 52 + i / 100 AS lat_deg,
       5 + n / 1e5 AS lon_deg FROM f, range(1000) AS r(n);
INSERT INTO segments BY NAME
SELECT flight_id, 1 AS channel_id, n // 10 AS frame_idx, n % 10 AS seg_idx, hash(n) % 1280 AS x1,
       hash(n, 1) % 720 AS y1, hash(n, 2) % 1280 AS x2, hash(n, 3) % 720 AS y2, 0.5 AS score, 40 AS length_px,
       hash(n, 4) % 180 AS angle_deg, n % 4 AS line_idx FROM f, range(10000) AS r(n);
INSERT INTO lines BY NAME
SELECT flight_id, 1 AS channel_id, n // 4 AS frame_idx, n % 4 AS line_idx, 2 AS n_points,
       [{'x': 1, 'y': 2}, {'x': 300, 'y': 400}] AS points, 1 AS x1, 2 AS y1, 300 AS x2, 400 AS y2, 0.9 AS score,
       hash(n, i) % 900 AS length_px, hash(n, 4) % 180 AS angle_deg, n % 4 AS track_id
FROM f, range(4000) AS r(n);
INSERT INTO tracks BY NAME
SELECT flight_id, 1 AS channel_id, n AS track_id, 0 AS first_frame_idx, 1000 AS last_frame_idx, t AS start_ns,
       t + n AS end_ns, 1000 - n AS n_frames, 3 AS n_coasted, 0.9 AS mean_score, 90 AS mean_angle_deg,
       10 AS mean_offset_px FROM f, range(20) AS r(n);
INSERT INTO spans BY NAME
SELECT 'S' || n AS span_id, 'L' || n // 100 AS line_id, 52 AS from_lat_deg, 5 AS from_lon_deg, 52 AS to_lat_deg,
       5 AS to_lon_deg, 55 AS length_m, 4 AS expected_conductors FROM range(1000) AS r(n);
INSERT INTO coverage BY NAME
SELECT flight_id, kind, NULL AS channel_id, NULL AS span_id, 's' AS unit, 100 AS total, 90 AS covered,
       0.9 AS share, '{}' AS thresholds
FROM f, (VALUES ('frame'), ('detection'), ('corridor')) AS k(kind)
UNION ALL BY NAME
SELECT flight_id, 'span' AS kind, 'S' || (i + n) % 1000 AS span_id, 'm' AS unit, 55 AS total, 50 AS imaged,
       45 AS covered, 0.8 AS share, 5 AS longest_gap_m, '{}' AS thresholds FROM f, range(10) AS r(n);
INSERT INTO coverage_bins BY NAME
SELECT flight_id, 'span' AS kind, 'S' || (i + n // 55) % 1000 AS span_id, n % 55 AS bin_idx, 1 AS length_m,
       52 AS lat_deg, 5 AS lon_deg, 10 AS n_frames, (n % 55 > 5)::INTEGER AS n_detected, 0.01 AS best_gsd_m,
       t AS first_ns, t + n AS last_ns FROM f, range(550) AS r(n);
INSERT INTO coverage_gaps BY NAME
SELECT flight_id, if(n % 2 = 0, 'frame', 'detection') AS kind, 1 AS channel_id, n AS first_frame_idx,
       n + 5 AS last_frame_idx, 5 AS n_frames, t AS start_ns, t + 2000000000 AS end_ns, 2 AS duration_s,
       10 AS length_m FROM f, range(10) AS r(n);
INSERT INTO conductor_counts BY NAME
SELECT flight_id, 1 AS channel_id, n % 1000 AS frame_idx,
       if(n < 1000, NULL, 'S' || (i + n % 10) % 1000) AS span_id, 4 AS n_conductors
FROM f, range(2000) AS r(n);
INSERT INTO anomalies BY NAME
SELECT left(sha256(flight_id || n), 12) AS anomaly_id, flight_id, 1 AS channel_id, 'conductor_count' AS kind,
       'why' AS reason, 3 AS value, 4 AS threshold, 'conductors' AS unit, n AS first_frame_idx,
       n + 10 AS last_frame_idx, [n] AS evidence_frames, t AS start_ns, t + 10 AS end_ns,
       'S' || (i + n) % 1000 AS span_id, 52 AS lat_deg, 5 AS lon_deg FROM f, range(5) AS r(n);
INSERT INTO flight_tags SELECT flight_id, 'line', 'L' || i % 10 FROM f;

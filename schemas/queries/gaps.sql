-- Pauses of the cameras and stretches without lines in flight $flight, the longest first.
SELECT kind, channel_id, start_utc, round(duration_s, 2) AS duration_s, round(length_m, 1) AS length_m, n_frames
FROM coverage_gaps
WHERE starts_with(flight_id, $flight)
ORDER BY duration_s DESC

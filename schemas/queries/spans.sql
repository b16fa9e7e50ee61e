-- Every span over all flights: how much of it was ever covered, and when last.
SELECT span_id, line_id, round(length_m, 1) AS length_m, round(100 * share, 1) AS seen_percent, n_flights, last_utc
FROM span_last_seen
ORDER BY line_id, span_id

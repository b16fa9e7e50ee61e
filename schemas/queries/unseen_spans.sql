-- Spans of which no flight covered anything, and why: never passed, passed but not seen, or unknown.
SELECT s.span_id,
       s.line_id,
       round(s.length_m, 1)                              AS length_m,
       count(c.flight_id)                                AS n_flights_near,
       CASE WHEN count(c.flight_id) = 0 THEN 'no flight near'
            ELSE coalesce(any_value(c.reason), 'no line found along it') END AS reason
FROM span_last_seen AS s
LEFT JOIN span_coverage AS c USING (span_id)
WHERE s.covered_m = 0
GROUP BY ALL
ORDER BY s.line_id, s.span_id

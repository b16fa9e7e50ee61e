-- Spans with what each flight near them covered; those that no flight came near have a row without flight_id.
SELECT s.*, c.flight_id, c.imaged_m, c.covered_m, c.share, c.unknown_m, c.reason, c.passed_m, c.longest_gap_m,
       c.first_ns, c.first_utc, c.last_ns, c.last_utc,
       (SELECT count(*) FROM anomalies AS a WHERE a.flight_id = c.flight_id AND a.span_id = s.span_id) AS n_anomalies
FROM spans AS s
LEFT JOIN (SELECT * FROM span_coverage WHERE flight_id IN (SELECT unnest($flight_ids))) AS c USING (span_id)
ORDER BY s.line_id, s.span_id, c.flight_id

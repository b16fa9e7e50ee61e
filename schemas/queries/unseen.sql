-- Spans of which no flight has seen anything.
SELECT span_id, line_id, round(length_m, 1) AS length_m
FROM unseen_spans
ORDER BY line_id, span_id

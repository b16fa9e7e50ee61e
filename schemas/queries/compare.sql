-- What changed on each span from flight $before to flight $after, of what both judged.
SELECT b.span_id,
       b.conductor,
       b.subject,
       round(a.value, 2)                               AS before,
       round(b.value, 2)                               AS after,
       round(sqrt(a.sd * a.sd + b.sd * b.sd), 2)       AS sd
FROM span_states AS a
JOIN span_states AS b
  ON a.span_id = b.span_id AND a.subject = b.subject AND a.conductor IS NOT DISTINCT FROM b.conductor
WHERE starts_with(a.flight_id, $before)
  AND starts_with(b.flight_id, $after)
  AND (b.conductor IS NULL OR a.n_conductors = b.n_conductors)
  AND abs(b.value - a.value) > coalesce(greatest(0.3, 3 * sqrt(a.sd * a.sd + b.sd * b.sd)), 0)
ORDER BY b.span_id, b.subject, b.conductor

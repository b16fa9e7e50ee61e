-- What flight $flight changed on each span since the last earlier flight that judged the same of it.
WITH pairs AS (
    SELECT b.span_id, b.conductor, b.subject, a.flight_id AS since, a.value AS before, b.value AS after,
           coalesce(greatest(0.3, 3 * sqrt(a.sd * a.sd + b.sd * b.sd)), 0) AS limit_m
    FROM span_states AS b
    JOIN span_states AS a
      ON a.span_id = b.span_id AND a.subject = b.subject AND a.conductor IS NOT DISTINCT FROM b.conductor
     AND a.start_ns < b.start_ns
    WHERE starts_with(b.flight_id, $flight) AND (b.conductor IS NULL OR a.n_conductors = b.n_conductors)
    QUALIFY row_number() OVER (PARTITION BY b.flight_id, b.span_id, b.subject, b.conductor ORDER BY a.start_ns DESC) = 1
)
SELECT span_id, conductor, subject, round(before, 2) AS before, round(after, 2) AS after, left(since, 16) AS since
FROM pairs
WHERE abs(after - before) > limit_m
ORDER BY span_id, subject, conductor

-- What the flights after $flight showed of each span that no flight up to it did, in metres.
WITH since AS (
    SELECT flight_id, start_ns > (SELECT start_ns FROM flights WHERE starts_with(flight_id, $flight)) AS is_later
    FROM flights
),
bins AS (
    SELECT b.span_id,
           b.bin_idx,
           any_value(b.length_m)                       AS length_m,
           max(b.n_detected) FILTER (NOT s.is_later)   AS n_before,
           max(b.n_detected) FILTER (s.is_later)       AS n_since
    FROM coverage_bins AS b
    JOIN since AS s USING (flight_id)
    WHERE b.kind = 'span'
    GROUP BY b.span_id, b.bin_idx
)
SELECT span_id,
       round(sum(length_m) FILTER (n_since > 0 AND coalesce(n_before, 0) = 0), 1) AS new_m,
       round(sum(length_m) FILTER (n_since > 0), 1)                               AS seen_m
FROM bins
GROUP BY span_id
HAVING new_m > 0
ORDER BY span_id

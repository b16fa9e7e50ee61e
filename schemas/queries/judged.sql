-- Per span of flight $flight, the share of it that each rule about conductors judged, and why not the rest.
SELECT span_id, kind, round(100 * judged_m / length_m, 1) AS judged_percent, why_not
FROM span_judged
WHERE starts_with(flight_id, $flight)
ORDER BY span_id, kind

-- The coverage of flight $flight, in all four definitions.
SELECT kind,
       coalesce(c.topic, 'all cameras')   AS camera,
       span_id,
       unit,
       round(total, 1)                    AS total,
       round(covered, 1)                  AS covered,
       round(100 * share, 1)              AS percent,
       round(longest_gap_s, 1)            AS longest_gap_s,
       round(longest_gap_m, 1)            AS longest_gap_m
FROM coverage AS v
LEFT JOIN channels AS c USING (flight_id, channel_id)
WHERE starts_with(flight_id, $flight)
ORDER BY kind, camera, span_id, unit

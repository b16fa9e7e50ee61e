-- Signals at the frames of flights, with where each was taken.
SELECT s.flight_id, s.channel_id, c.topic, s.frame_idx, f.log_time_ns, f.log_time_utc, s.name, s.value, f.lat_deg, f.lon_deg,
       f.alt_m, f.height_m
FROM signals AS s
LEFT JOIN frames AS f USING (flight_id, channel_id, frame_idx)
LEFT JOIN channels AS c USING (flight_id, channel_id)
WHERE s.flight_id IN (SELECT unnest($flight_ids))
ORDER BY s.flight_id, s.channel_id, s.frame_idx, s.name

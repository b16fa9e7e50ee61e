-- Pauses of the cameras and stretches without lines, from the place of the first frame to that of the last.
SELECT g.flight_id, g.channel_id, c.topic, g.kind, g.first_frame_idx, g.last_frame_idx, g.n_frames, g.start_ns,
       g.start_utc, g.end_ns, g.end_utc, g.duration_s, g.length_m,
       a.lat_deg AS from_lat_deg, a.lon_deg AS from_lon_deg, b.lat_deg AS to_lat_deg, b.lon_deg AS to_lon_deg
FROM coverage_gaps AS g
LEFT JOIN channels AS c USING (flight_id, channel_id)
LEFT JOIN frames AS a ON (a.flight_id, a.channel_id, a.frame_idx) = (g.flight_id, g.channel_id, g.first_frame_idx)
LEFT JOIN frames AS b ON (b.flight_id, b.channel_id, b.frame_idx) = (g.flight_id, g.channel_id, g.last_frame_idx)
WHERE g.flight_id IN (SELECT unnest($flight_ids))
ORDER BY g.flight_id, g.channel_id, g.start_ns, g.kind

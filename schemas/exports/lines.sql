-- Lines of the frames of flights, in pixels.
SELECT l.flight_id, l.channel_id, c.topic, l.frame_idx, f.log_time_ns, f.log_time_utc, f.width, f.height, l.line_idx,
       l.track_id, l.points, l.x1, l.y1, l.x2, l.y2, l.score, l.track_score, l.length_px, l.angle_deg
FROM lines AS l
LEFT JOIN frames AS f USING (flight_id, channel_id, frame_idx)
LEFT JOIN channels AS c USING (flight_id, channel_id)
WHERE l.flight_id IN (SELECT unnest($flight_ids))
ORDER BY l.flight_id, l.channel_id, l.frame_idx, l.line_idx

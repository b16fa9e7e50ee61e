-- Frames of flights, with where each was taken.
SELECT f.flight_id, f.channel_id, c.topic, f.frame_idx, f.log_time_ns, f.log_time_utc, f.stamp_ns, f.status, f.reason,
       f.width, f.height, f.n_segments, f.n_lines, f.sharpness, f.mean_luma, f.lat_deg, f.lon_deg, f.alt_m, f.height_m,
       f.heading_deg, f.cam_yaw_deg, f.cam_pitch_deg, f.cam_roll_deg, f.pose_age_ms, f.attitude_source, f.focal_px,
       f.gsd_m, f.ground_lat_deg, f.ground_lon_deg, f.wire_px
FROM frames AS f
LEFT JOIN channels AS c USING (flight_id, channel_id)
WHERE f.flight_id IN (SELECT unnest($flight_ids))
ORDER BY f.flight_id, f.channel_id, f.frame_idx

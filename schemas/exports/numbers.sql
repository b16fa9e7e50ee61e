-- Numbers of the frames of flights for the plots of viewers, with the conductors counted in the whole picture.
SELECT f.channel_id, f.frame_idx, f.log_time_ns, f.status, f.lat_deg, f.lon_deg, f.n_lines, f.n_segments, n.n_conductors,
       f.sharpness, f.mean_luma, f.height_m, f.gsd_m, s.signals
FROM frames AS f
LEFT JOIN conductor_counts AS n
  ON (n.flight_id, n.channel_id, n.frame_idx) = (f.flight_id, f.channel_id, f.frame_idx) AND n.span_id IS NULL
LEFT JOIN (
    SELECT flight_id, channel_id, frame_idx, list({'name': name, 'value': value} ORDER BY name) AS signals
    FROM signals
    WHERE flight_id IN (SELECT unnest($flight_ids)) AND value IS NOT NULL
    GROUP BY ALL
) AS s ON (s.flight_id, s.channel_id, s.frame_idx) = (f.flight_id, f.channel_id, f.frame_idx)
WHERE f.flight_id IN (SELECT unnest($flight_ids))
ORDER BY f.log_time_ns, f.channel_id, f.frame_idx

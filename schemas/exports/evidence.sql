-- Frames that show anomalies of flights which nobody has dismissed, each with all of them.
SELECT f.flight_id, f.channel_id, c.topic, f.frame_idx, f.log_time_ns, f.log_time_utc, f.width, f.height, f.lat_deg,
       f.lon_deg, f.alt_m, f.height_m, f.heading_deg, f.cam_yaw_deg, f.cam_pitch_deg, f.cam_roll_deg, f.focal_px,
       e.anomaly_ids, e.kinds, e.priorities, e.reasons, e.span_ids
FROM (
    SELECT flight_id, channel_id, frame_idx,
           list(anomaly_id ORDER BY anomaly_id)          AS anomaly_ids,
           list(DISTINCT kind ORDER BY kind)             AS kinds,
           list(DISTINCT priority ORDER BY priority)     AS priorities,
           list(DISTINCT reason ORDER BY reason)         AS reasons,
           list(DISTINCT span_id ORDER BY span_id) FILTER (span_id IS NOT NULL) AS span_ids
    FROM (
        SELECT *, unnest(if(len(evidence_frames) > 0, evidence_frames, [first_frame_idx])) AS frame_idx
        FROM reviewed_anomalies
        WHERE verdict <> 'dismissed' AND flight_id IN (SELECT unnest($flight_ids))
    )
    GROUP BY flight_id, channel_id, frame_idx
) AS e
JOIN frames AS f USING (flight_id, channel_id, frame_idx)
LEFT JOIN channels AS c USING (flight_id, channel_id)
WHERE f.width IS NOT NULL
ORDER BY f.flight_id, f.channel_id, f.frame_idx

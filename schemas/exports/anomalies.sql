-- Anomalies of flights with their reviews.
SELECT *
FROM reviewed_anomalies
WHERE flight_id IN (SELECT unnest($flight_ids))
ORDER BY flight_id, start_ns, anomaly_id

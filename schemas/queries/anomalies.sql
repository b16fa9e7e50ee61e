-- Anomalies that nobody has reviewed, of all flights, by time.
SELECT anomaly_id, left(flight_id, 16) AS flight, kind, start_utc, span_id, reason
FROM reviewed_anomalies
WHERE verdict = 'open'
ORDER BY start_ns, anomaly_id

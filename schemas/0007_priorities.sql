-- How urgent an anomaly is, and ids by which other systems know a span. Frozen: see 0002.

ALTER TABLE anomalies ADD COLUMN priority VARCHAR; -- 'high', 'medium' or 'low', as the rules say of its kind

ALTER TABLE spans ADD COLUMN asset_id VARCHAR;     -- in the owner's asset register
ALTER TABLE spans ADD COLUMN mrid VARCHAR;         -- mRID of the Common Information Model (IEC 61970)

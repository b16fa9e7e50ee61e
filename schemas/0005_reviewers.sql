-- Who reviewed an anomaly, and checksums by which damage to the index is found. Frozen: see 0002.

ALTER TABLE reviews ADD COLUMN reviewed_by VARCHAR; -- NULL in reviews of older versions

CREATE TABLE checksums (
    table_name     VARCHAR PRIMARY KEY,  -- of tables whose rows `index verify` cannot compare with flights
    n_rows         BIGINT NOT NULL,
    checksum       VARCHAR NOT NULL,     -- sum of the hashes of all rows
    duckdb_version VARCHAR NOT NULL      -- another version may hash differently
);

-- How runs ended. Frozen: a later change is a new numbered file.

ALTER TABLE runs ADD COLUMN command VARCHAR;        -- 'process' or 'batch'; NULL in stores of before
ALTER TABLE runs ADD COLUMN tags JSON;              -- of --tag; NULL in stores of before
ALTER TABLE runs ADD COLUMN finished_at TIMESTAMP;  -- NULL, as all that follow, when killed or under way
ALTER TABLE runs ADD COLUMN exit_code INTEGER;
ALTER TABLE runs ADD COLUMN error VARCHAR;          -- the message, where the run itself failed
ALTER TABLE runs ADD COLUMN n_processed INTEGER;    -- recordings made flights
ALTER TABLE runs ADD COLUMN n_skipped INTEGER;      -- done before
ALTER TABLE runs ADD COLUMN n_failed INTEGER;       -- refused by `process`
ALTER TABLE runs ADD COLUMN n_quarantined INTEGER;  -- given up by this run

-- What is unknown about coverage, and which parts of the spans the rules about conductors judged.

ALTER TABLE coverage ALTER COLUMN total DROP NOT NULL;   -- NULL without positions
ALTER TABLE coverage ALTER COLUMN covered DROP NOT NULL; -- NULL where nothing of it can be known
ALTER TABLE coverage ADD COLUMN unknown DOUBLE;          -- part of total of which nothing can be known; share is
                                                         -- covered / (total - unknown)
ALTER TABLE coverage ADD COLUMN reason VARCHAR;          -- why something is unknown
ALTER TABLE coverage ADD COLUMN passed DOUBLE;           -- of a span: metres within near_m of the path

ALTER TABLE coverage_bins ADD COLUMN is_unknown BOOLEAN; -- no frame could show whether it is covered

CREATE TABLE span_judgements (
    flight_id VARCHAR NOT NULL,
    span_id   VARCHAR NOT NULL,
    kind      VARCHAR NOT NULL,            -- of the anomalies that the rule finds
    outcome   VARCHAR NOT NULL,            -- 'judged', or why not, such as 'too few views'
    length_m  DOUBLE NOT NULL              -- of the span with this outcome; all of a kind sum to its length
);

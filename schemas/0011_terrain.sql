-- The ground below frames by a terrain model. Frozen: see 0002.

ALTER TABLE frames ADD COLUMN rise_m DOUBLE; -- of the ground, from below the first position; NULL without a model

-- How sure the other frames nearby are of a line. Frozen: see 0002.

ALTER TABLE lines ADD COLUMN track_score FLOAT; -- NULL without at least three lines of its track in other frames

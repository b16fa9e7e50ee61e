-- Cameras that take photographs, not video: pauses and turns between their frames say nothing.

ALTER TABLE channels ADD COLUMN is_stills BOOLEAN DEFAULT false;

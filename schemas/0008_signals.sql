-- Numbers of other topics at the times of frames. Frozen: see 0002.

CREATE TABLE signals (
    flight_id  VARCHAR NOT NULL,
    channel_id INTEGER NOT NULL,           -- of the camera
    frame_idx  INTEGER NOT NULL,
    name       VARCHAR NOT NULL,           -- as the options of the run call it
    value      DOUBLE                      -- the last before the frame; NULL where there is none of the last 10 s
);

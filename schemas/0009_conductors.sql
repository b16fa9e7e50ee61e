-- Conductors of spans as a flight measured them in space. Frozen: see 0002.

CREATE TABLE conductors (
    flight_id      VARCHAR NOT NULL,
    channel_id     INTEGER NOT NULL,        -- of the camera
    span_id        VARCHAR NOT NULL,
    conductor      INTEGER NOT NULL,        -- counted from the right, looking from the first structure
    n_frames       INTEGER NOT NULL,        -- in which it was found
    judged_m       DOUBLE NOT NULL,         -- of the span, along which its presence could be judged
    present_m      DOUBLE NOT NULL,         -- of these, along which it is present
    across_m       DOUBLE NOT NULL,         -- to the left of the straight line between the structures
    across_sd_m    DOUBLE,                  -- standard deviations; NULL where too little of it was measured
    raised_m       DOUBLE NOT NULL,         -- above the height of conductors that the spans file gives
    raised_sd_m    DOUBLE,
    sag_m          DOUBLE,                  -- in the middle of the span
    sag_sd_m       DOUBLE,
    ground_m       DOUBLE,                  -- least height above the ground
    ground_sd_m    DOUBLE,
    clearance_m    DOUBLE,                  -- least distance to another conductor of the span
    nearest        INTEGER                  -- the number of that conductor
);

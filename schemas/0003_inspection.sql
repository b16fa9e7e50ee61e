-- Where frames were taken, lines followed over frames, the grid's spans, and what follows from all of them.
--
-- Positions are WGS 84 in degrees, altitudes in metres as the source counts them. Angles of the camera: yaw
-- clockwise from north, pitch positive upwards (straight down is -90), roll positive to the right.

ALTER TABLE frames ADD COLUMN lat_deg DOUBLE;            -- of the camera
ALTER TABLE frames ADD COLUMN lon_deg DOUBLE;
ALTER TABLE frames ADD COLUMN alt_m DOUBLE;
ALTER TABLE frames ADD COLUMN height_m DOUBLE;           -- above the ground
ALTER TABLE frames ADD COLUMN heading_deg DOUBLE;        -- of the vehicle, clockwise from north
ALTER TABLE frames ADD COLUMN cam_roll_deg DOUBLE;
ALTER TABLE frames ADD COLUMN cam_pitch_deg DOUBLE;
ALTER TABLE frames ADD COLUMN cam_yaw_deg DOUBLE;
ALTER TABLE frames ADD COLUMN pose_age_ms DOUBLE;        -- of the oldest part of the pose
ALTER TABLE frames ADD COLUMN attitude_source VARCHAR;   -- 'camera', 'vehicle', or 'nadir' where assumed
ALTER TABLE frames ADD COLUMN focal_px DOUBLE;           -- of the lens, in pixels of this frame
ALTER TABLE frames ADD COLUMN gsd_m DOUBLE;              -- metres of ground in a pixel at the image's centre
ALTER TABLE frames ADD COLUMN ground_lat_deg DOUBLE;     -- where the optical axis meets the ground
ALTER TABLE frames ADD COLUMN ground_lon_deg DOUBLE;
ALTER TABLE frames ADD COLUMN wire_px DOUBLE;            -- how wide a conductor is expected to appear

ALTER TABLE lines ADD COLUMN track_id INTEGER;

CREATE TABLE tracks (
    flight_id       VARCHAR NOT NULL,
    channel_id      INTEGER NOT NULL,
    track_id        INTEGER NOT NULL,
    first_frame_idx INTEGER NOT NULL,
    last_frame_idx  INTEGER NOT NULL,
    start_ns        BIGINT NOT NULL,
    start_utc       TIMESTAMP GENERATED ALWAYS AS (make_timestamp(start_ns // 1000)),
    end_ns          BIGINT NOT NULL,
    end_utc         TIMESTAMP GENERATED ALWAYS AS (make_timestamp(end_ns // 1000)),
    n_frames        INTEGER NOT NULL,      -- in which it was found
    n_coasted       INTEGER NOT NULL,      -- between them, in which it was not
    mean_score      FLOAT NOT NULL,
    mean_angle_deg  FLOAT NOT NULL,        -- in [0, 180)
    mean_offset_px  FLOAT NOT NULL         -- from the middle of the image
);

CREATE TABLE spans (
    span_id             VARCHAR PRIMARY KEY,
    line_id             VARCHAR,
    from_structure      VARCHAR,
    to_structure        VARCHAR,
    from_lat_deg        DOUBLE NOT NULL,
    from_lon_deg        DOUBLE NOT NULL,
    from_height_m       DOUBLE,            -- of the conductors above the ground
    to_lat_deg          DOUBLE NOT NULL,
    to_lon_deg          DOUBLE NOT NULL,
    to_height_m         DOUBLE,
    length_m            DOUBLE NOT NULL,
    expected_conductors INTEGER
);

CREATE TABLE coverage (
    flight_id     VARCHAR NOT NULL,
    kind          VARCHAR NOT NULL,        -- 'frame', 'detection', 'span' or 'corridor'
    channel_id    INTEGER,                 -- NULL: over all cameras of the flight
    span_id       VARCHAR,                 -- of kind 'span' only
    unit          VARCHAR NOT NULL,        -- of total, imaged and covered: 'frames', 's' or 'm'
    total         DOUBLE NOT NULL,
    imaged        DOUBLE,                  -- inside a usable frame; NULL where the kind does not say
    covered       DOUBLE NOT NULL,
    share         DOUBLE,                  -- covered / total, 0 to 1; NULL when total is 0
    longest_gap_s DOUBLE,
    longest_gap_m DOUBLE,
    thresholds    JSON NOT NULL            -- that decided it
);

CREATE TABLE coverage_bins (
    flight_id  VARCHAR NOT NULL,
    kind       VARCHAR NOT NULL,           -- 'span' or 'corridor'
    span_id    VARCHAR,
    bin_idx    INTEGER NOT NULL,           -- from the span's first structure, or from the start of the path
    length_m   DOUBLE NOT NULL,
    lat_deg    DOUBLE NOT NULL,            -- of the middle of the bin
    lon_deg    DOUBLE NOT NULL,
    n_frames   INTEGER NOT NULL,           -- usable frames that show it finely enough
    n_detected INTEGER NOT NULL,           -- of these, with a line along it
    best_gsd_m DOUBLE,
    first_ns   BIGINT,                     -- of the frames in n_detected
    last_ns    BIGINT
);

CREATE TABLE coverage_gaps (
    flight_id       VARCHAR NOT NULL,
    kind            VARCHAR NOT NULL,      -- 'frame' or 'detection'
    channel_id      INTEGER NOT NULL,
    first_frame_idx INTEGER NOT NULL,      -- 'frame': the last before; 'detection': the first without lines
    last_frame_idx  INTEGER NOT NULL,      -- 'frame': the first after; 'detection': the last without lines
    n_frames        INTEGER NOT NULL,      -- that are missing, or without lines
    start_ns        BIGINT NOT NULL,
    start_utc       TIMESTAMP GENERATED ALWAYS AS (make_timestamp(start_ns // 1000)),
    end_ns          BIGINT NOT NULL,
    end_utc         TIMESTAMP GENERATED ALWAYS AS (make_timestamp(end_ns // 1000)),
    duration_s      DOUBLE NOT NULL,
    length_m        DOUBLE                 -- flown meanwhile; NULL without positions
);

CREATE TABLE conductor_counts (
    flight_id    VARCHAR NOT NULL,
    channel_id   INTEGER NOT NULL,
    frame_idx    INTEGER NOT NULL,
    span_id      VARCHAR,                  -- NULL: of the whole picture
    n_conductors INTEGER NOT NULL          -- side by side, smoothed over frames
);

CREATE TABLE anomalies (
    anomaly_id      VARCHAR NOT NULL,      -- stays the same when the flight is processed again
    flight_id       VARCHAR NOT NULL,
    channel_id      INTEGER NOT NULL,
    kind            VARCHAR NOT NULL,
    reason          VARCHAR NOT NULL,      -- a sentence
    value           DOUBLE NOT NULL,       -- that passed the threshold
    threshold       DOUBLE NOT NULL,
    unit            VARCHAR NOT NULL,      -- of both
    first_frame_idx INTEGER NOT NULL,
    last_frame_idx  INTEGER NOT NULL,
    evidence_frames INTEGER[] NOT NULL,    -- a few frames to look at
    start_ns        BIGINT NOT NULL,
    start_utc       TIMESTAMP GENERATED ALWAYS AS (make_timestamp(start_ns // 1000)),
    end_ns          BIGINT NOT NULL,
    end_utc         TIMESTAMP GENERATED ALWAYS AS (make_timestamp(end_ns // 1000)),
    track_id        INTEGER,
    span_id         VARCHAR,
    lat_deg         DOUBLE,                -- on the span where it has one, else of the camera
    lon_deg         DOUBLE
);

CREATE TABLE reviews (
    anomaly_id  VARCHAR PRIMARY KEY,
    verdict     VARCHAR NOT NULL,          -- 'confirmed' or 'dismissed'
    note        VARCHAR NOT NULL,
    reviewed_at TIMESTAMP NOT NULL
);

CREATE TABLE flight_tags (
    flight_id VARCHAR NOT NULL,
    key       VARCHAR NOT NULL,
    value     VARCHAR NOT NULL
);

CREATE TABLE inputs (
    name   VARCHAR PRIMARY KEY,            -- what else than flights the index was made of
    sha256 VARCHAR NOT NULL
);

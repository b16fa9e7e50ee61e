-- Facts about flights. Frozen: a later change is a new numbered file.
--
-- Units are in the names: _ns nanoseconds since 1970 UTC, _ms, _px source pixels (origin at the top-left
-- corner of the top-left pixel), _deg degrees. A *_utc column is its *_ns neighbour as a TIMESTAMP,
-- computed when read, so the two cannot disagree; TIMESTAMP columns are in UTC.
-- The big tables have no primary key: a flight's rows are replaced whole, in one transaction.

CREATE TABLE schema_version (
    version     INTEGER PRIMARY KEY,
    applied_at  TIMESTAMP NOT NULL,
    app_version VARCHAR NOT NULL         -- that last wrote the index
);

CREATE TABLE models (
    model_id        VARCHAR PRIMARY KEY,
    name            VARCHAR NOT NULL,
    preset          VARCHAR NOT NULL,
    weights_sha256  VARCHAR NOT NULL,
    score_threshold DOUBLE NOT NULL
);

CREATE TABLE runs (
    run_id        UUID PRIMARY KEY,
    started_at    TIMESTAMP NOT NULL,
    host          VARCHAR NOT NULL,
    app_version   VARCHAR NOT NULL,
    config_sha256 VARCHAR NOT NULL,
    config        JSON NOT NULL
);

CREATE TABLE flights (
    flight_id     VARCHAR PRIMARY KEY, -- sha256 of the recording; its folder is the first 16 digits
    source_uri    VARCHAR NOT NULL,
    source_bytes  BIGINT NOT NULL,
    run_id        UUID NOT NULL,
    model_id      VARCHAR NOT NULL,
    config_sha256 VARCHAR NOT NULL,
    status        VARCHAR NOT NULL,    -- 'ok' or 'recovered'
    reason        VARCHAR,
    start_ns      BIGINT,              -- log time of the first and of the last frame
    end_ns        BIGINT,
    start_utc     TIMESTAMP GENERATED ALWAYS AS (make_timestamp(start_ns // 1000)),
    end_utc       TIMESTAMP GENERATED ALWAYS AS (make_timestamp(end_ns // 1000)),
    n_frames      BIGINT NOT NULL,
    n_bad_frames  BIGINT NOT NULL,
    n_segments    BIGINT NOT NULL,
    n_lines       BIGINT NOT NULL,
    ingested_at   TIMESTAMP NOT NULL,
    result_sha256 VARCHAR NOT NULL     -- of the result.json these rows come from
);

CREATE TABLE channels (
    flight_id        VARCHAR NOT NULL,
    channel_id       INTEGER NOT NULL,
    topic            VARCHAR NOT NULL,
    schema_name      VARCHAR NOT NULL,
    message_encoding VARCHAR NOT NULL,
    message_count    BIGINT,           -- NULL when the recording has no statistics
    first_ns         BIGINT,           -- log time of the first and of the last frame
    last_ns          BIGINT,
    first_utc        TIMESTAMP GENERATED ALWAYS AS (make_timestamp(first_ns // 1000)),
    last_utc         TIMESTAMP GENERATED ALWAYS AS (make_timestamp(last_ns // 1000))
);

CREATE TABLE frames (
    flight_id    VARCHAR NOT NULL,
    channel_id   INTEGER NOT NULL,
    frame_idx    INTEGER NOT NULL,
    log_time_ns  BIGINT NOT NULL,
    log_time_utc TIMESTAMP GENERATED ALWAYS AS (make_timestamp(log_time_ns // 1000)),
    stamp_ns     BIGINT NOT NULL,      -- the image's own header stamp
    stamp_utc    TIMESTAMP GENERATED ALWAYS AS (make_timestamp(stamp_ns // 1000)),
    width        INTEGER,              -- px; NULL when the image could not be decoded
    height       INTEGER,
    status       VARCHAR NOT NULL,     -- 'ok' or 'bad'
    reason       VARCHAR,              -- why a frame is bad
    sharpness    FLOAT,                -- variance of the Laplacian of luma
    mean_luma    FLOAT,                -- 0 to 255
    n_segments   INTEGER NOT NULL,
    n_lines      INTEGER NOT NULL,
    infer_ms     FLOAT
);

CREATE TABLE segments (
    flight_id  VARCHAR NOT NULL,
    channel_id INTEGER NOT NULL,
    frame_idx  INTEGER NOT NULL,
    seg_idx    INTEGER NOT NULL,
    x1         FLOAT NOT NULL,         -- px
    y1         FLOAT NOT NULL,
    x2         FLOAT NOT NULL,
    y2         FLOAT NOT NULL,
    score      FLOAT NOT NULL,
    length_px  FLOAT NOT NULL,
    angle_deg  FLOAT NOT NULL,         -- in [0, 180); x to the right, y down
    line_idx   INTEGER                 -- the line of the same frame it belongs to
);

CREATE TABLE lines (
    flight_id  VARCHAR NOT NULL,
    channel_id INTEGER NOT NULL,
    frame_idx  INTEGER NOT NULL,
    line_idx   INTEGER NOT NULL,
    n_points   INTEGER NOT NULL,
    points     STRUCT(x FLOAT, y FLOAT)[] NOT NULL, -- px, in order along the line
    x1         FLOAT NOT NULL,         -- the chord: first and last point, px
    y1         FLOAT NOT NULL,
    x2         FLOAT NOT NULL,
    y2         FLOAT NOT NULL,
    score      FLOAT NOT NULL,
    length_px  FLOAT NOT NULL,         -- along the points
    angle_deg  FLOAT NOT NULL          -- of the chord, in [0, 180)
);

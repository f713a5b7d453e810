CREATE TABLE e3pose_store (
    version INTEGER NOT NULL
);
CREATE TABLE energy (
    run_id BIGINT NOT NULL,
    time_ns BIGINT NOT NULL,
    camera_id TEXT NOT NULL,
    energy_j FLOAT NOT NULL,
    span_s FLOAT NOT NULL,
    charge FLOAT,
    source TEXT NOT NULL,
    PRIMARY KEY (run_id, time_ns, camera_id)
)
 WITHOUT ROWID;
CREATE TABLE events (
    run_id BIGINT NOT NULL,
    time_ns BIGINT NOT NULL,
    number BIGINT NOT NULL,
    kind TEXT NOT NULL,
    camera_id TEXT,
    message TEXT NOT NULL,
    PRIMARY KEY (run_id, time_ns, number)
)
 WITHOUT ROWID;
CREATE TABLE poses (
    run_id BIGINT NOT NULL,
    slot BIGINT NOT NULL,
    track_id BIGINT NOT NULL,
    time_ns BIGINT NOT NULL,
    joints_m BLOB NOT NULL,
    scores BLOB NOT NULL,
    sigma_m BLOB,
    measured BLOB NOT NULL,
    PRIMARY KEY (run_id, slot, track_id)
)
 WITHOUT ROWID;
CREATE TABLE runs (
    run_id INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
    site TEXT NOT NULL,
    name TEXT NOT NULL,
    started_ns BIGINT NOT NULL,
    interval_ns BIGINT NOT NULL,
    skeleton TEXT NOT NULL,
    joints TEXT NOT NULL,
    cameras TEXT NOT NULL,
    software TEXT NOT NULL,
    UNIQUE (site, started_ns)
);
CREATE TABLE slots (
    run_id BIGINT NOT NULL,
    slot BIGINT NOT NULL,
    time_ns BIGINT NOT NULL,
    selected TEXT NOT NULL,
    arrived TEXT NOT NULL,
    next_selection TEXT NOT NULL,
    occlusion BLOB NOT NULL,
    deficit BLOB NOT NULL,
    energy_j BLOB,
    took_s FLOAT NOT NULL,
    PRIMARY KEY (run_id, slot)
)
 WITHOUT ROWID;
CREATE INDEX slots_by_time ON slots (time_ns);
CREATE TABLE tracks (
    run_id BIGINT NOT NULL,
    track_id BIGINT NOT NULL,
    first_slot BIGINT NOT NULL,
    last_slot BIGINT NOT NULL,
    first_ns BIGINT NOT NULL,
    last_ns BIGINT NOT NULL,
    PRIMARY KEY (run_id, track_id)
)
 WITHOUT ROWID;

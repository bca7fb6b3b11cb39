CREATE TABLE IF NOT EXISTS runs (
    run INTEGER PRIMARY KEY,
    run_id TEXT NOT NULL UNIQUE,
    kind TEXT NOT NULL,
    started TEXT NOT NULL,
    ended TEXT,
    state TEXT NOT NULL,
    reason TEXT,
    software TEXT NOT NULL,
    settings TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS origins (
    run INTEGER PRIMARY KEY REFERENCES runs,
    record TEXT NOT NULL,
    begun_s REAL,
    begun_at TEXT
);
CREATE TABLE IF NOT EXISTS steps (
    run INTEGER NOT NULL REFERENCES runs,
    ordinal INTEGER NOT NULL,
    key TEXT NOT NULL,
    kind TEXT NOT NULL,
    detail TEXT NOT NULL,
    begun REAL,
    finished REAL,
    result TEXT,
    error TEXT,
    aside INTEGER NOT NULL DEFAULT 0,
    PRIMARY KEY (run, ordinal)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS balls (
    run INTEGER NOT NULL REFERENCES runs,
    ordinal INTEGER NOT NULL,
    key TEXT NOT NULL,
    record TEXT NOT NULL,
    PRIMARY KEY (run, ordinal)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS temperatures (
    run INTEGER NOT NULL REFERENCES runs,
    ordinal INTEGER NOT NULL,
    key TEXT NOT NULL,
    record TEXT NOT NULL,
    PRIMARY KEY (run, ordinal)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS events (
    run INTEGER NOT NULL REFERENCES runs,
    at TEXT NOT NULL,
    kind TEXT NOT NULL,
    record TEXT NOT NULL,
    aside INTEGER NOT NULL DEFAULT 0
);
CREATE TABLE IF NOT EXISTS decisions (
    run INTEGER NOT NULL REFERENCES runs,
    at TEXT NOT NULL,
    kind TEXT NOT NULL,
    record TEXT NOT NULL,
    aside INTEGER NOT NULL DEFAULT 0
);
CREATE TABLE IF NOT EXISTS estimates (
    run INTEGER NOT NULL REFERENCES runs,
    at TEXT NOT NULL,
    record TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS tables (
    run INTEGER NOT NULL REFERENCES runs,
    at TEXT NOT NULL,
    role TEXT NOT NULL,
    bank INTEGER NOT NULL,
    crc32 INTEGER,
    origin_mm TEXT,
    step_mm TEXT,
    resolution_mm REAL,
    shape TEXT,
    counts BLOB,
    aside INTEGER NOT NULL DEFAULT 0
);
CREATE TABLE IF NOT EXISTS compacted_runs (
    run INTEGER PRIMARY KEY REFERENCES runs,
    balls INTEGER NOT NULL,
    touches INTEGER NOT NULL,
    content BLOB NOT NULL
);
CREATE TABLE IF NOT EXISTS idle_alarms (
    number INTEGER PRIMARY KEY,
    at TEXT NOT NULL,
    until TEXT,
    record TEXT NOT NULL
);
CREATE INDEX IF NOT EXISTS events_of_run ON events (run);
CREATE INDEX IF NOT EXISTS decisions_of_run ON decisions (run);
CREATE INDEX IF NOT EXISTS estimates_of_run ON estimates (run);
CREATE INDEX IF NOT EXISTS tables_of_run ON tables (run);
CREATE VIEW IF NOT EXISTS touches AS
    SELECT run, ordinal, key, detail, finished AS at, result
    FROM steps WHERE kind = 'TouchTowards' AND result IS NOT NULL AND NOT aside;

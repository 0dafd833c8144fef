//! The store: cycles, the state of each recipe, and alarms in one SQLite file.
//!
//! SQLite writes a write-ahead log that is synced at each commit (`synchronous = FULL`). A completed commit survives
//! the end of the process and a power failure. A recipe's state is written from time to time, with the number of the
//! last cycle in it. After a restart, later cycles are processed again, which gives an identical state.

use std::path::Path;

use rusqlite::{Connection, OptionalExtension, params};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::recipe::RecipeState;
use crate::warn::Tally;
use crate::{Alarm, Cycle};

/// The version of the tables.
const FORM: i64 = 1;
/// Number of cycles per deletion.
const SWEEP: u64 = 2_000;

/// Settings of the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct StoreSettings {
    /// Number of cycles kept on disk. A cycle whose id was deleted counts again if it is sent again.
    pub keep_cycles: u64,
    /// Number of alarms kept on disk.
    pub keep_alarms: u64,
    /// Maximum size of the store, in MiB. Beyond it, cycles are refused as if the disk were full. 0 means no limit.
    pub most_mib: u64,
}

impl Default for StoreSettings {
    fn default() -> Self {
        Self { keep_cycles: 1_000_000, keep_alarms: 100_000, most_mib: 0 }
    }
}

/// An error of the store.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The disk is full, or the store has reached its size limit.
    #[error(
        "the disk is full, or the store has reached `most_mib`. Hint: free space, decrease `keep_cycles` or increase `most_mib`"
    )]
    Full,
    /// Another process uses the store.
    #[error("another process uses this store")]
    InUse,
    /// The store has another version.
    #[error("the store has version {found}. Expected version {FORM}")]
    Form {
        /// The version of the store.
        found: i64,
    },
    /// A row that cannot be read.
    #[error("{what} in the store cannot be read: {because}")]
    Damaged {
        /// The row.
        what: String,
        /// The cause.
        because: String,
    },
    /// Any other error.
    #[error("store: {0}")]
    Sqlite(rusqlite::Error),
}

impl From<rusqlite::Error> for StoreError {
    fn from(error: rusqlite::Error) -> Self {
        match error.sqlite_error_code() {
            Some(rusqlite::ErrorCode::DiskFull) => Self::Full,
            Some(rusqlite::ErrorCode::DatabaseBusy | rusqlite::ErrorCode::DatabaseLocked) => Self::InUse,
            _ => Self::Sqlite(error),
        }
    }
}

/// The store.
#[derive(Debug)]
pub struct Store {
    connection: Connection,
    settings: StoreSettings,
}

/// The result of adding a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kept {
    /// The cycle is new and has this number.
    New(u64),
    /// The id is known, with the same content.
    Same,
    /// The id is known, with other content.
    Other,
}

impl Store {
    /// Opens or creates the store at `path`. Only one process may use it.
    ///
    /// # Errors
    /// If the file cannot be opened, is used by another process, or has another version.
    pub fn open(path: &Path, settings: StoreSettings) -> Result<Self, StoreError> {
        Self::prepare(Connection::open(path)?, settings)
    }

    /// Creates a store in memory, for a feed that ends with the process.
    ///
    /// # Errors
    /// If SQLite failed.
    pub fn in_memory(settings: StoreSettings) -> Result<Self, StoreError> {
        Self::prepare(Connection::open_in_memory()?, settings)
    }

    fn prepare(connection: Connection, settings: StoreSettings) -> Result<Self, StoreError> {
        connection.busy_timeout(std::time::Duration::ZERO)?;
        // Exclusive: a second process fails immediately, and the log needs no shared memory.
        connection.execute_batch(
            "PRAGMA locking_mode = EXCLUSIVE; PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL;
             PRAGMA temp_store = MEMORY; PRAGMA wal_autocheckpoint = 4000; PRAGMA journal_size_limit = 67108864;
             BEGIN EXCLUSIVE;
             CREATE TABLE IF NOT EXISTS facts (name TEXT PRIMARY KEY, value INTEGER NOT NULL) WITHOUT ROWID;
             CREATE TABLE IF NOT EXISTS cycles (
                 seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, recipe TEXT NOT NULL, robot TEXT NOT NULL,
                 time_s REAL NOT NULL, body TEXT NOT NULL);
             CREATE TABLE IF NOT EXISTS recipes (name TEXT PRIMARY KEY, seq INTEGER NOT NULL, state TEXT NOT NULL);
             CREATE TABLE IF NOT EXISTS alarms (
                 n INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, body TEXT NOT NULL);
             COMMIT;",
        )?;
        let store = Self { connection, settings };
        match store.fact("form")? {
            None => store.set_fact("form", FORM)?,
            Some(FORM) => {}
            Some(found) => return Err(StoreError::Form { found }),
        }
        if settings.most_mib > 0 {
            let page: i64 = store.connection.query_row("PRAGMA page_size", [], |row| row.get(0))?;
            let pages = (settings.most_mib << 20) / page.max(1) as u64;
            store.connection.query_row(&format!("PRAGMA max_page_count = {pages}"), [], |_| Ok(()))?;
        }
        Ok(store)
    }

    fn fact(&self, name: &str) -> Result<Option<i64>, StoreError> {
        let mut found = self.connection.prepare_cached("SELECT value FROM facts WHERE name = ?1")?;
        Ok(found.query_row([name], |row| row.get(0)).optional()?)
    }

    fn set_fact(&self, name: &str, value: i64) -> Result<(), StoreError> {
        self.connection
            .prepare_cached("INSERT OR REPLACE INTO facts VALUES (?1, ?2)")?
            .execute(params![name, value])?;
        Ok(())
    }

    /// Checks that the store can be written.
    pub(super) fn probe(&self) -> Result<(), StoreError> {
        self.set_fact("probe", 1)
    }

    /// Begins a transaction. [`Self::commit`] ends it.
    pub(super) fn begin(&self) -> Result<(), StoreError> {
        Ok(self.connection.execute_batch("BEGIN IMMEDIATE")?)
    }

    /// Writes the transaction to disk. It is durable when this returns.
    pub(super) fn commit(&self) -> Result<(), StoreError> {
        Ok(self.connection.execute_batch("COMMIT")?)
    }

    /// Rolls the transaction back.
    pub(super) fn roll_back(&self) {
        // A full disk may have rolled it back already.
        let _ = self.connection.execute_batch("ROLLBACK");
    }

    /// Runs `work` in one transaction, which is rolled back on an error.
    pub(super) fn together(&self, work: impl FnOnce() -> Result<(), StoreError>) -> Result<(), StoreError> {
        self.begin()?;
        let done = work().and_then(|()| self.commit());
        if done.is_err() {
            self.roll_back();
        }
        done
    }

    /// Adds a cycle with the text `body`.
    pub(super) fn add(&self, cycle: &Cycle, body: &str) -> Result<Kept, StoreError> {
        let mut insert = self.connection.prepare_cached(
            "INSERT INTO cycles (id, recipe, robot, time_s, body) VALUES (?1, ?2, ?3, ?4, ?5) ON CONFLICT (id) DO NOTHING",
        )?;
        if insert.execute(params![cycle.id, cycle.recipe, cycle.robot, cycle.time_s, body])? > 0 {
            return Ok(Kept::New(self.connection.last_insert_rowid().cast_unsigned()));
        }
        let mut known = self.connection.prepare_cached("SELECT body FROM cycles WHERE id = ?1")?;
        let known: String = known.query_row([&cycle.id], |row| row.get(0))?;
        // The same cycle may have its keys in another order.
        let same = known == body || serde_json::from_str::<Cycle>(&known).is_ok_and(|known| known == *cycle);
        Ok(if same { Kept::Same } else { Kept::Other })
    }

    /// Writes the state of a recipe after the cycle `seq`.
    pub(super) fn keep_recipe(&self, name: &str, seq: u64, state: &RecipeState) -> Result<(), StoreError> {
        let text = serde_json::to_string(state)
            .map_err(|e| StoreError::Damaged { what: format!("recipe `{name}`"), because: e.to_string() })?;
        let mut insert = self.connection.prepare_cached("INSERT OR REPLACE INTO recipes VALUES (?1, ?2, ?3)")?;
        insert.execute(params![name, seq.cast_signed(), text])?;
        Ok(())
    }

    /// The state of each recipe, with the number of its last cycle.
    pub(super) fn recipes(&self) -> Result<Vec<(String, u64, RecipeState)>, StoreError> {
        let mut all = self.connection.prepare("SELECT name, seq, state FROM recipes ORDER BY name")?;
        let rows = all.query_map([], |row| Ok((row.get(0)?, row.get::<_, i64>(1)?, row.get::<_, String>(2)?)))?;
        rows.map(|row| {
            let (name, seq, text): (String, i64, String) = row?;
            let state = serde_json::from_str(&text)
                .map_err(|e| StoreError::Damaged { what: format!("recipe `{name}`"), because: e.to_string() })?;
            Ok((name, seq.cast_unsigned(), state))
        })
        .collect()
    }

    /// All recipes with the numbers of their stored cycles.
    ///
    /// # Errors
    /// If SQLite failed.
    pub fn recipe_counts(&self) -> Result<Vec<(String, u64)>, StoreError> {
        let mut all = self.connection.prepare(
            "SELECT name, (SELECT COUNT(*) FROM cycles WHERE recipe = name) FROM
             (SELECT name FROM recipes UNION SELECT DISTINCT recipe FROM cycles) ORDER BY name",
        )?;
        let rows = all.query_map([], |row| Ok((row.get(0)?, row.get::<_, i64>(1)?.cast_unsigned())))?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    /// Removes a recipe with its cycles and its state. Alarms stay. Returns the number of cycles.
    ///
    /// # Errors
    /// If SQLite failed. Nothing was removed.
    pub fn remove_recipe(&self, name: &str) -> Result<u64, StoreError> {
        let mut removed = 0;
        self.together(|| {
            removed = self.connection.execute("DELETE FROM cycles WHERE recipe = ?1", [name])? as u64;
            self.connection.execute("DELETE FROM recipes WHERE name = ?1", [name])?;
            Ok(())
        })?;
        Ok(removed)
    }

    /// Gives all cycles of a recipe to another one. The next start computes its state from the stored cycles of both. Returns the
    /// number of moved cycles.
    ///
    /// # Errors
    /// If SQLite failed. Nothing was changed.
    pub fn merge_recipe(&self, from: &str, into: &str) -> Result<u64, StoreError> {
        let mut moved = 0;
        self.together(|| {
            let sql = "UPDATE cycles SET recipe = ?2, body = json_set(body, '$.recipe', ?2) WHERE recipe = ?1";
            moved = self.connection.execute(sql, [from, into])? as u64;
            self.connection.execute("DELETE FROM recipes WHERE name IN (?1, ?2)", [from, into])?;
            Ok(())
        })?;
        Ok(moved)
    }

    /// Calls `process` with each cycle that is not in its recipe's state, in order.
    pub(super) fn unprocessed(&self, mut process: impl FnMut(u64, &Cycle)) -> Result<(), StoreError> {
        let mut all = self.connection.prepare(
            "SELECT c.seq, c.body FROM cycles c LEFT JOIN recipes r ON r.name = c.recipe
             WHERE r.seq IS NULL OR c.seq > r.seq ORDER BY c.seq",
        )?;
        let mut rows = all.query([])?;
        while let Some(row) = rows.next()? {
            let (seq, body): (i64, String) = (row.get(0)?, row.get(1)?);
            let cycle = serde_json::from_str(&body)
                .map_err(|e| StoreError::Damaged { what: format!("cycle {seq}"), because: e.to_string() })?;
            process(seq.cast_unsigned(), &cycle);
        }
        Ok(())
    }

    /// The newest time of each robot's cycles.
    pub(super) fn robots(&self, most: usize) -> Result<Vec<(String, f64)>, StoreError> {
        let mut all = self.connection.prepare("SELECT robot, MAX(time_s) FROM cycles GROUP BY robot LIMIT ?1")?;
        let rows = all.query_map([most as i64], |row| Ok((row.get(0)?, row.get(1)?)))?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    /// The last cycles, newest first, as they were sent.
    pub(super) fn last_cycles(&self, n: u32) -> Result<Vec<String>, StoreError> {
        let mut last = self.connection.prepare_cached("SELECT body FROM cycles ORDER BY seq DESC LIMIT ?1")?;
        let rows = last.query_map([n], |row| row.get(0))?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    /// The cycles of a recipe up to the one with this id, newest first. Empty if it is not stored any more.
    pub(super) fn cycles_until(&self, recipe: &str, id: &str, n: u32) -> Result<Vec<String>, StoreError> {
        // The limit on `seq` bounds the search for a recipe with few cycles.
        let mut last = self.connection.prepare_cached(
            "SELECT c.body FROM cycles c, (SELECT seq FROM cycles WHERE id = ?2) AS found
             WHERE c.seq <= found.seq AND c.seq > found.seq - 20000 AND c.recipe = ?1 ORDER BY c.seq DESC LIMIT ?3",
        )?;
        let rows = last.query_map(params![recipe, id, n], |row| row.get(0))?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    /// Adds alarms in order. Known alarms are not changed.
    pub(super) fn add_alarms(&self, alarms: &[Alarm]) -> Result<(), StoreError> {
        let sql = "INSERT INTO alarms (id, body) VALUES (?1, ?2) ON CONFLICT (id) DO NOTHING";
        let mut insert = self.connection.prepare_cached(sql)?;
        for alarm in alarms {
            let body = serde_json::to_string(alarm)
                .map_err(|e| StoreError::Damaged { what: format!("alarm `{}`", alarm.id), because: e.to_string() })?;
            insert.execute(params![alarm.id, body])?;
        }
        Ok(())
    }

    /// The alarms after number `n`, oldest first, at most `most`.
    pub(super) fn alarms_after(&self, n: u64, most: u32) -> Result<Vec<(u64, String)>, StoreError> {
        let mut all = self.connection.prepare_cached("SELECT n, body FROM alarms WHERE n > ?1 ORDER BY n LIMIT ?2")?;
        let rows = all.query_map(params![n.cast_signed(), most], |row| Ok((row.get::<_, i64>(0)?, row.get(1)?)))?;
        rows.map(|row| row.map(|(n, body)| (n.cast_unsigned(), body)).map_err(StoreError::from)).collect()
    }

    /// The last alarms, newest first.
    pub(super) fn last_alarms(&self, most: u32) -> Result<Vec<String>, StoreError> {
        let mut all = self.connection.prepare_cached("SELECT body FROM alarms ORDER BY n DESC LIMIT ?1")?;
        let rows = all.query_map([most], |row| row.get(0))?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    /// The number of the last alarm that an output delivered.
    pub(super) fn delivered(&self, output: &str) -> Result<u64, StoreError> {
        Ok(self.fact(&format!("delivered:{output}"))?.unwrap_or(0).cast_unsigned())
    }

    /// Registers an output. A new output begins with the next alarm.
    pub(super) fn register(&self, output: &str) -> Result<(), StoreError> {
        self.connection
            .prepare_cached("INSERT OR IGNORE INTO facts SELECT ?1, COALESCE(MAX(n), 0) FROM alarms")?
            .execute([format!("delivered:{output}")])?;
        Ok(())
    }

    /// Records that an output delivered every alarm up to number `n`.
    pub(super) fn set_delivered(&self, output: &str, n: u64) -> Result<(), StoreError> {
        self.set_fact(&format!("delivered:{output}"), n.cast_signed())
    }

    /// The number up to which cycles can be deleted. `None` if too few can be deleted.
    pub(super) fn too_old(&self, newest: u64) -> Option<u64> {
        let surplus = newest.saturating_sub(self.settings.keep_cycles);
        let first: Option<i64> = self
            .connection
            .prepare_cached("SELECT seq FROM cycles ORDER BY seq LIMIT 1")
            .and_then(|mut first| first.query_row([], |row| row.get(0)))
            .ok();
        let first = first?.cast_unsigned();
        (surplus >= first + SWEEP.min(self.settings.keep_cycles / 10)).then_some(surplus)
    }

    /// Deletes cycles up to this number, and alarms beyond the limit.
    pub(super) fn sweep(&self, up_to: u64) -> Result<(), StoreError> {
        self.connection.execute("DELETE FROM cycles WHERE seq <= ?1", [up_to.cast_signed()])?;
        self.connection.execute(
            "DELETE FROM alarms WHERE n <= (SELECT MAX(n) FROM alarms) - ?1",
            [self.settings.keep_alarms.cast_signed()],
        )?;
        Ok(())
    }

    /// The counts of the episodes that a detector watched, added to those of `from`, which has none.
    pub(super) fn tally(&self, sha256: &str, from: Tally) -> Result<Tally, StoreError> {
        let mut tally = from;
        for (name, count) in tally.counts_mut() {
            *count = self.fact(&format!("warner:{sha256}:{name}"))?.unwrap_or(0).cast_unsigned();
        }
        tally.suspended = self.fact(&format!("warner:{sha256}:suspended"))?.unwrap_or(0) != 0;
        Ok(tally)
    }

    /// Writes the counts of the episodes that a detector watched.
    pub(super) fn keep_tally(&self, sha256: &str, tally: &Tally) -> Result<(), StoreError> {
        let mut tally = *tally;
        self.set_fact(&format!("warner:{sha256}:suspended"), tally.suspended.into())?;
        let counts = tally.counts_mut();
        counts
            .into_iter()
            .try_for_each(|(name, count)| self.set_fact(&format!("warner:{sha256}:{name}"), count.cast_signed()))
    }

    /// The number of the newest cycle. 0 without cycles.
    pub(super) fn newest(&self) -> Result<u64, StoreError> {
        let newest: i64 =
            self.connection.query_row("SELECT COALESCE(MAX(seq), 0) FROM cycles", [], |row| row.get(0))?;
        Ok(newest.cast_unsigned())
    }
}

//! Keeps the results of slow reads, within a budget, and forgets those used least recently.

use std::{
    collections::HashMap,
    fs,
    hash::Hash,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::SystemTime,
};

/// A file as it was when it was read: another length or time means another content.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct FileKey {
    path: PathBuf,
    modified: Option<SystemTime>,
    len: u64,
}

impl FileKey {
    /// The file at `path` as it is now; a missing file has a key too, and its reader says so.
    pub(crate) fn of(path: &Path) -> Self {
        let meta = fs::metadata(path).ok();
        Self {
            path: path.to_owned(),
            modified: meta.as_ref().and_then(|meta| meta.modified().ok()),
            len: meta.map_or(0, |meta| meta.len()),
        }
    }
}

/// Results by key. Two threads that ask for the same key at once compute it once.
pub(crate) struct Cache<K, V> {
    budget_bytes: usize,
    entries: Mutex<Entries<K, V>>,
}

struct Entries<K, V> {
    slots: HashMap<K, Entry<V>>,
    /// Sizes of all entries together.
    total_bytes: usize,
    /// Counts uses; the entry with the smallest is the oldest.
    now: u64,
}

struct Entry<V> {
    slot: Slot<V>,
    size_bytes: usize,
    last_used: u64,
}

/// Locked while its value is being computed.
type Slot<V> = Arc<Mutex<Option<Arc<V>>>>;

impl<K: Clone + Eq + Hash, V> Cache<K, V> {
    /// An empty cache that holds values of `budget_bytes` in all.
    pub(crate) fn new(budget_bytes: usize) -> Self {
        Self { budget_bytes, entries: Mutex::new(Entries { slots: HashMap::new(), total_bytes: 0, now: 0 }) }
    }

    /// The value of `key`, computed if it is not here. An error is not kept: the next caller tries again.
    pub(crate) fn get_or_try_insert<E>(
        &self,
        key: &K,
        size_bytes: impl FnOnce(&V) -> usize,
        compute: impl FnOnce() -> Result<V, E>,
    ) -> Result<Arc<V>, E> {
        let slot = self.slot(key);
        let mut value = lock(&slot);
        if let Some(value) = &*value {
            return Ok(value.clone());
        }
        match compute() {
            Ok(computed) => {
                let size_bytes = size_bytes(&computed);
                let computed = Arc::new(computed);
                *value = Some(computed.clone());
                drop(value);
                self.charge(key, size_bytes);
                Ok(computed)
            }
            Err(err) => {
                drop(value);
                lock(&self.entries).remove(key);
                Err(err)
            }
        }
    }

    fn slot(&self, key: &K) -> Slot<V> {
        let mut entries = lock(&self.entries);
        entries.now += 1;
        let last_used = entries.now;
        let entry = entries.slots.entry(key.clone()).or_insert_with(|| Entry {
            slot: Slot::default(),
            size_bytes: 0,
            last_used,
        });
        entry.last_used = last_used;
        entry.slot.clone()
    }

    /// Books the size of a new value and makes room for it. The newest value stays, however large it is.
    fn charge(&self, key: &K, size_bytes: usize) {
        let mut entries = lock(&self.entries);
        entries.charge(key, size_bytes);
        while entries.total_bytes > self.budget_bytes {
            let oldest = entries
                .slots
                .iter()
                .filter(|(other, entry)| *other != key && entry.size_bytes > 0)
                .min_by_key(|(_, entry)| entry.last_used)
                .map(|(other, _)| other.clone());
            match oldest {
                Some(oldest) => entries.remove(&oldest),
                None => break,
            }
        }
    }
}

impl<K: Eq + Hash, V> Entries<K, V> {
    /// Sets the size of an entry, if it is still here.
    fn charge(&mut self, key: &K, size_bytes: usize) {
        if let Some(entry) = self.slots.get_mut(key) {
            self.total_bytes = self.total_bytes - entry.size_bytes + size_bytes;
            entry.size_bytes = size_bytes;
        }
    }

    fn remove(&mut self, key: &K) {
        if let Some(entry) = self.slots.remove(key) {
            self.total_bytes -= entry.size_bytes;
        }
    }
}

/// Locks even after a panic elsewhere: what these mutexes guard is replaced whole, never half-written.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use proptest::prelude::*;

    use super::*;

    fn fetch(cache: &Cache<u32, u32>, key: u32, computed: &AtomicUsize) -> u32 {
        let value = cache.get_or_try_insert(
            &key,
            |_| 10,
            || {
                computed.fetch_add(1, Ordering::Relaxed);
                Ok::<_, ()>(key * 2)
            },
        );
        *value.unwrap()
    }

    #[test]
    fn least_recently_used_value_makes_room() {
        let cache = Cache::new(20);
        let computed = AtomicUsize::new(0);
        for key in [1, 2, 1, 3] {
            assert_eq!(fetch(&cache, key, &computed), key * 2);
        }
        assert_eq!(computed.load(Ordering::Relaxed), 3);
        fetch(&cache, 1, &computed);
        assert_eq!(computed.load(Ordering::Relaxed), 3, "1 was used after 2, so 2 had to go");
        fetch(&cache, 2, &computed);
        assert_eq!(computed.load(Ordering::Relaxed), 4);
    }

    #[test]
    fn value_beyond_the_budget_is_still_given() {
        let cache = Cache::new(5);
        let computed = AtomicUsize::new(0);
        assert_eq!(fetch(&cache, 1, &computed), 2);
        assert_eq!(fetch(&cache, 1, &computed), 2);
        assert_eq!(computed.load(Ordering::Relaxed), 1);
    }

    proptest! {
        #[test]
        fn total_is_the_sum_after_whatever_is_asked(
            asked in proptest::collection::vec((0u32..8, proptest::option::of(0usize..40)), 1..60),
        ) {
            let cache = Cache::<u32, usize>::new(60);
            for (key, size) in asked {
                // Without a size it cannot be computed.
                let found = cache.get_or_try_insert(&key, |&size| size, || size.ok_or(()));
                prop_assert!(found.is_ok() || size.is_none());
                let entries = lock(&cache.entries);
                let sum: usize = entries.slots.values().map(|entry| entry.size_bytes).sum();
                prop_assert_eq!(entries.total_bytes, sum);
                prop_assert!(sum <= 60, "each value fits");
                prop_assert_eq!(found.is_ok(), entries.slots.contains_key(&key));
            }
        }
    }

    #[test]
    fn errors_are_not_kept() {
        let cache = Cache::<u32, u32>::new(100);
        assert_eq!(cache.get_or_try_insert(&1, |_| 1, || Err("no")), Err("no"));
        assert_eq!(cache.get_or_try_insert(&1, |_| 1, || Ok::<_, &str>(7)).map(|value| *value), Ok(7));
    }

    #[test]
    fn threads_that_ask_at_once_compute_once() {
        let cache = Cache::new(100);
        let computed = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| fetch(&cache, 5, &computed));
            }
        });
        assert_eq!(computed.load(Ordering::Relaxed), 1);
    }

    #[test]
    fn changed_file_has_another_key() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let before = FileKey::of(file.path());
        fs::write(file.path(), "longer").unwrap();
        assert_ne!(before, FileKey::of(file.path()));
    }
}

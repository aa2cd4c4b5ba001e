//! How a publisher ends: with its handle or with its session.
use crate::error::Result;
use std::sync::{Arc, Mutex, MutexGuard};
use zenoh::matching::MatchingListener;
use zenoh::Wait;

/// A publisher that ends with its handle or with its session, whichever comes first: Zenoh never
/// frees a session that was closed while a publisher was declared on it.
pub struct Ending {
    live: Mutex<Option<Arc<Live>>>,
    /// Held while the publisher ends, so that a second call of `end` waits for the first.
    ending: Mutex<()>,
}

pub struct Live {
    pub publisher: zenoh::pubsub::Publisher<'static>,
    listeners: Mutex<Vec<MatchingListener<()>>>,
}

pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

impl Ending {
    pub fn new(publisher: zenoh::pubsub::Publisher<'static>) -> Self {
        let live = Arc::new(Live { publisher, listeners: Mutex::default() });
        Ending { live: Mutex::new(Some(live)), ending: Mutex::default() }
    }

    /// The lock is not held while Zenoh is called, because a callback may use this publisher.
    pub fn live(&self) -> Result<Arc<Live>> {
        lock(&self.live).clone().ok_or_else(|| "the session is closed".into())
    }

    /// If a put is running on another thread, the publisher ends when that put returns.
    pub fn end(&self) -> Result<()> {
        let _ending = lock(&self.ending);
        let live = lock(&self.live).take();
        match live.map(Arc::try_unwrap) {
            Some(Ok(live)) => live.undeclare(),
            _ => Ok(()),
        }
    }
}

impl Live {
    /// The listener ends with the publisher.
    pub fn keep(&self, listener: MatchingListener<()>) {
        lock(&self.listeners).push(listener);
    }

    fn undeclare(self) -> Result<()> {
        for listener in self.listeners.into_inner().unwrap_or_else(|p| p.into_inner()) {
            listener.undeclare().wait_callbacks().wait()?;
        }
        self.publisher.undeclare().wait_callbacks().wait()
    }
}

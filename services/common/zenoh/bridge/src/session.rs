//! Sessions and Zenoh's log.
use crate::abi::{hand_out, shield, take_back, Slice};
use crate::config::Config;
use crate::ending::{lock, Ending};
use crate::error::{guard, Result, Status};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::sync::{Mutex, Weak};
use std::time::Duration;
use zenoh::key_expr::KeyExpr;
use zenoh::Wait;

pub struct Session {
    pub zenoh: zenoh::Session,
    /// Receives the result of a close that is still running.
    closing: Mutex<Option<Receiver<Result<()>>>>,
    /// Publishers that must be undeclared before the session is closed.
    publishers: Mutex<Vec<Weak<Ending>>>,
}

impl Session {
    pub fn end_before_close(&self, publisher: Weak<Ending>) {
        let mut publishers = lock(&self.publishers);
        publishers.retain(|known| known.strong_count() > 0);
        publishers.push(publisher);
    }

    /// Starts to close on a thread of its own, since Zenoh may take ten seconds and more on a bad
    /// link.
    fn start_closing(&self) -> Result<Receiver<Result<()>>> {
        let publishers = std::mem::take(&mut *lock(&self.publishers));
        let session = self.zenoh.clone();
        let (done, wait) = mpsc::channel();
        std::thread::Builder::new().name("zloam-close".into()).spawn(move || {
            // If undeclaring a publisher fails, close the session nevertheless.
            for publisher in publishers.iter().filter_map(Weak::upgrade) {
                let _ = publisher.end();
            }
            let result = session.close().wait_callbacks().wait();
            drop(session);
            let _ = done.send(result);
        })?;
        Ok(wait)
    }
}

/// A key expression in canonical form.
pub unsafe fn key_expression(key: Slice) -> Result<KeyExpr<'static>> {
    KeyExpr::autocanonize(key.text()?.to_owned())
}

#[no_mangle]
pub unsafe extern "C" fn zloam_session_open(
    config: *const Config,
    out: *mut *mut Session,
) -> Status {
    guard(|| {
        let zenoh = zenoh::open((*config).0.clone()).wait()?;
        hand_out(out, Session { zenoh, closing: Mutex::default(), publishers: Mutex::default() });
        Ok(())
    })
}

/// If the deadline passes first, the closing thread continues, and the next call waits for it.
#[no_mangle]
pub unsafe extern "C" fn zloam_session_close(
    session: *const Session,
    deadline_ms: u64,
    closed: *mut bool,
) -> Status {
    guard(|| {
        *closed = false;
        let session = &*session;
        let mut closing = lock(&session.closing);
        let end = match closing.take() {
            Some(end) => end,
            None => session.start_closing()?,
        };
        match end.recv_timeout(Duration::from_millis(deadline_ms)) {
            Ok(result) => {
                result?;
                *closed = true;
            }
            Err(RecvTimeoutError::Timeout) => *closing = Some(end),
            Err(error) => return Err(error.into()),
        }
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_session_drop(session: *mut Session) {
    take_back(session, |_| Ok(()));
}

#[no_mangle]
pub unsafe extern "C" fn zloam_session_zid(
    session: *const Session,
    buffer: *mut u8,
    capacity: usize,
) -> usize {
    let mut size = 0;
    shield(|| {
        let text = (*session).zenoh.zid().to_string();
        size = text.len().min(capacity);
        std::ptr::copy_nonoverlapping(text.as_ptr(), buffer, size);
    });
    size
}

#[no_mangle]
pub unsafe extern "C" fn zloam_session_links(
    session: *const Session,
    buffer: *mut u8,
    capacity: usize,
) -> usize {
    let mut size = 0;
    shield(|| {
        let ends = (*session).zenoh.info().links().wait();
        let text = ends.map(|link| link.dst().to_string()).collect::<Vec<_>>().join("\n");
        std::ptr::copy_nonoverlapping(text.as_ptr(), buffer, text.len().min(capacity));
        size = text.len();
    });
    size
}

#[no_mangle]
pub unsafe extern "C" fn zloam_init_log(fallback_level: Slice) -> Status {
    guard(|| {
        zenoh::init_log_from_env_or(fallback_level.text()?);
        // Panics print nothing: the failed call returns their text.
        std::panic::set_hook(Box::new(|_| {}));
        Ok(())
    })
}

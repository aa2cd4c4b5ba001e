//! Sessions and Zenoh's log.
use crate::abi::{hand_out, shield, take_back, Slice};
use crate::config::Config;
use crate::error::{guard, Result, Status};
use std::sync::mpsc;
use std::time::Duration;
use zenoh::key_expr::KeyExpr;
use zenoh::Wait;

pub struct Session(pub zenoh::Session);

/// A key expression in canonical form.
pub unsafe fn key_expression(key: Slice) -> Result<KeyExpr<'static>> {
    Ok(KeyExpr::autocanonize(key.text()?.to_owned())?)
}

#[no_mangle]
pub unsafe extern "C" fn zloam_session_open(
    config: *const Config,
    out: *mut *mut Session,
) -> Status {
    guard(|| {
        hand_out(out, Session(zenoh::open((*config).0.clone()).wait()?));
        Ok(())
    })
}

/// Zenoh's own close may hang for ten seconds and more on a bad link; so it runs on a thread of its
/// own, which is left behind when the deadline passes.
#[no_mangle]
pub unsafe extern "C" fn zloam_session_close(
    session: *const Session,
    deadline_ms: u64,
    closed: *mut bool,
) -> Status {
    guard(|| {
        *closed = false;
        let session = (*session).0.clone();
        let (done, wait) = mpsc::channel();
        std::thread::Builder::new()
            .name("zloam-close".into())
            .spawn(move || {
                let result = session.close().wait_callbacks().wait();
                drop(session);
                let _ = done.send(result);
            })?;
        match wait.recv_timeout(Duration::from_millis(deadline_ms)) {
            Ok(result) => {
                result?;
                *closed = true;
                Ok(())
            }
            Err(mpsc::RecvTimeoutError::Timeout) => Ok(()),
            Err(error) => Err(error.into()),
        }
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
        let text = (*session).0.zid().to_string();
        size = text.len().min(capacity);
        std::ptr::copy_nonoverlapping(text.as_ptr(), buffer, size);
    });
    size
}

#[no_mangle]
pub unsafe extern "C" fn zloam_init_log(fallback_level: Slice) -> Status {
    guard(|| {
        zenoh::init_log_from_env_or(fallback_level.text()?);
        Ok(())
    })
}

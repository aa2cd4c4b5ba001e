//! Status codes, the text of the last failure, and the net that catches panics.
use std::any::Any;
use std::cell::RefCell;
use std::ffi::{c_char, CString};
use std::panic::{catch_unwind, AssertUnwindSafe};

pub type Error = Box<dyn std::error::Error + Send + Sync>;
pub type Result<T> = std::result::Result<T, Error>;

#[repr(i32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    Ok = 0,
    Error = -1,
    Panic = -2,
}

thread_local! {
    static LAST_ERROR: RefCell<CString> = RefCell::new(CString::default());
}

fn set_last_error(text: &str) {
    let text = CString::new(text.replace('\0', " ")).unwrap_or_default();
    LAST_ERROR.with(|last| *last.borrow_mut() = text);
}

fn panic_text(payload: &(dyn Any + Send)) -> &str {
    if let Some(text) = payload.downcast_ref::<&str>() {
        text
    } else if let Some(text) = payload.downcast_ref::<String>() {
        text
    } else {
        "it gave no reason"
    }
}

/// Runs the body of a function of the ABI: errors and panics become a status and a text.
pub fn guard(body: impl FnOnce() -> Result<()>) -> Status {
    match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => Status::Ok,
        Ok(Err(error)) => {
            set_last_error(&error.to_string());
            Status::Error
        }
        Err(payload) => {
            set_last_error(&format!("Zenoh failed: {}", panic_text(payload.as_ref())));
            Status::Panic
        }
    }
}

/// Text of the last failed call on this thread; valid until the next failed call on this thread.
#[no_mangle]
pub extern "C" fn zloam_last_error() -> *const c_char {
    LAST_ERROR.with(|last| last.borrow().as_ptr())
}

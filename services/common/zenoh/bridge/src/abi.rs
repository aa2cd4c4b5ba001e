//! Types that cross the boundary: borrowed byte ranges, closures, boxed handles.
use crate::error::{guard, Result, Status};
use std::ffi::c_void;
use std::panic::{catch_unwind, AssertUnwindSafe};

/// A borrowed range of bytes; `data` may be null when `size` is 0.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Slice {
    pub data: *const u8,
    pub size: usize,
}
const _: () = assert!(std::mem::size_of::<Slice>() == 16);

impl Slice {
    pub const EMPTY: Slice = Slice { data: std::ptr::null(), size: 0 };

    pub fn of(bytes: &[u8]) -> Self {
        Slice { data: bytes.as_ptr(), size: bytes.len() }
    }

    pub unsafe fn bytes<'a>(self) -> &'a [u8] {
        if self.size == 0 {
            &[]
        } else {
            std::slice::from_raw_parts(self.data, self.size)
        }
    }

    pub unsafe fn text<'a>(self) -> Result<&'a str> {
        Ok(std::str::from_utf8(self.bytes())?)
    }
}

pub type DropFn = unsafe extern "C" fn(context: *mut c_void);

/// The context of a C closure, with the function that frees it.
pub struct Context {
    pointer: *mut c_void,
    drop: DropFn,
}
// SAFETY: the header demands that contexts may be used and freed on any thread.
unsafe impl Send for Context {}
unsafe impl Sync for Context {}

impl Context {
    pub fn new(pointer: *mut c_void, drop: DropFn) -> Self {
        Context { pointer, drop }
    }

    pub fn pointer(&self) -> *mut c_void {
        self.pointer
    }
}

impl Drop for Context {
    fn drop(&mut self) {
        // SAFETY: the only call of the drop function.
        unsafe { (self.drop)(self.pointer) }
    }
}

/// Stores a new handle at `out`.
pub unsafe fn hand_out<T>(out: *mut *mut T, value: T) {
    *out = Box::into_raw(Box::new(value));
}

/// Takes a handle back and lets `end` finish it; errors and panics stay here.
pub unsafe fn take_back<T>(handle: *mut T, end: impl FnOnce(T) -> Result<()>) {
    if !handle.is_null() {
        guard(|| end(*Box::from_raw(handle)));
    }
}

/// Runs our half of a callback; a panic in it must not reach Zenoh's threads.
pub fn shield(body: impl FnOnce()) {
    let _ = catch_unwind(AssertUnwindSafe(body));
}

/// For tests: panics with the given text.
///
/// # Safety
/// `text` must be valid.
#[no_mangle]
pub unsafe extern "C" fn zloam_test_panic(text: Slice) -> Status {
    guard(|| panic!("{}", text.text()?))
}

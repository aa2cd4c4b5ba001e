//! Received samples as C sees them.
use crate::abi::{shield, Context, Slice};
use crate::bytes::Bytes;
use std::borrow::Cow;
use std::ffi::c_void;

/// Valid during the call it is passed to, except `payload` and `attachment`, which become the
/// callee's. `attachment` is null when there is none.
#[repr(C)]
pub struct Sample {
    pub key: Slice,
    pub encoding: Slice,
    pub payload: *mut Bytes,
    pub attachment: *mut Bytes,
    pub kind: u8,
    pub priority: u8,
    pub congestion_control: u8,
    pub express: bool,
}
const _: () = assert!(std::mem::size_of::<Sample>() == 56);

pub type OnSample = unsafe extern "C" fn(context: *mut c_void, sample: *const Sample);

/// Passes the sample to `use_it` in the form of the ABI.
pub fn with_view(sample: &zenoh::sample::Sample, use_it: impl FnOnce(&Sample)) {
    let encoding: Cow<'static, str> = sample.encoding().into();
    use_it(&Sample {
        key: Slice::of(sample.key_expr().as_str().as_bytes()),
        encoding: Slice::of(encoding.as_bytes()),
        payload: Bytes::boxed(sample.payload().clone()),
        attachment: match sample.attachment() {
            Some(bytes) => Bytes::boxed(bytes.clone()),
            None => std::ptr::null_mut(),
        },
        kind: sample.kind() as u8,
        priority: sample.priority() as u8,
        congestion_control: sample.congestion_control() as u8,
        express: sample.express(),
    });
}

/// The Rust closure around a C one.
pub fn sample_closure(
    call: OnSample,
    context: Context,
) -> impl Fn(zenoh::sample::Sample) + Send + Sync + 'static {
    move |sample| {
        let context = &context;
        // SAFETY: the header demands that `call` may run on any thread until `drop` was called.
        shield(|| with_view(&sample, |view| unsafe { call(context.pointer(), view) }));
    }
}

//! Payloads: reference-counted byte ranges, from memory of C++ or from Zenoh.
use crate::abi::{hand_out, take_back, Context, DropFn, Slice};
use crate::error::{guard, Status};
use std::ffi::c_void;
use zenoh::bytes::ZBytes;
use zenoh::shm::ShmBuf;

pub struct Bytes(pub ZBytes);

impl Bytes {
    pub fn boxed(bytes: ZBytes) -> *mut Bytes {
        Box::into_raw(Box::new(Bytes(bytes)))
    }

    /// Another reference to the same bytes; null stands for no bytes.
    pub unsafe fn share(handle: *const Bytes) -> Option<ZBytes> {
        handle.as_ref().map(|bytes| bytes.0.clone())
    }
}

/// Memory that C++ owns until the last reference goes.
struct Foreign {
    data: *const u8,
    size: usize,
    _owner: Context,
}
// SAFETY: the bytes are immutable while they are shared, and the owner may go on any thread.
unsafe impl Send for Foreign {}
unsafe impl Sync for Foreign {}

impl AsRef<[u8]> for Foreign {
    fn as_ref(&self) -> &[u8] {
        // SAFETY: the owner keeps the range alive as long as self.
        unsafe { Slice { data: self.data, size: self.size }.bytes() }
    }
}

/// The one slice of contiguous bytes; none when they are in several.
fn contiguous(bytes: &ZBytes) -> Option<Slice> {
    let mut slices = bytes.slices();
    match (slices.next(), slices.next()) {
        (None, _) => Some(Slice::EMPTY),
        (Some(only), None) => Some(Slice::of(only)),
        _ => None,
    }
}

#[no_mangle]
pub unsafe extern "C" fn zloam_bytes_own(
    data: *const u8,
    size: usize,
    context: *mut c_void,
    drop: DropFn,
    out: *mut *mut Bytes,
) -> Status {
    let owner = Foreign { data, size, _owner: Context::new(context, drop) };
    guard(|| {
        hand_out(out, Bytes(::bytes::Bytes::from_owner(owner).into()));
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_bytes_copy(data: Slice, out: *mut *mut Bytes) -> Status {
    guard(|| {
        hand_out(out, Bytes(data.bytes().to_vec().into()));
        Ok(())
    })
}

/// A copy in slices of at most `part` bytes: Zenoh applies the threshold of its implicit shared
/// memory to each slice.
#[no_mangle]
pub unsafe extern "C" fn zloam_bytes_in_parts(
    bytes: *const Bytes,
    part: usize,
    out: *mut *mut Bytes,
) -> Status {
    guard(|| {
        let mut writer = ZBytes::writer();
        for slice in (*bytes).0.slices() {
            for chunk in slice.chunks(part.max(1)) {
                writer.append(chunk.to_vec().into());
            }
        }
        hand_out(out, Bytes(writer.finish()));
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_bytes_drop(bytes: *mut Bytes) {
    take_back(bytes, |_| Ok(()));
}

#[no_mangle]
pub unsafe extern "C" fn zloam_bytes_size(bytes: *const Bytes) -> usize {
    (*bytes).0.len()
}

#[no_mangle]
pub unsafe extern "C" fn zloam_bytes_is_shared_memory(bytes: *const Bytes) -> bool {
    (*bytes).0.as_shm().is_some()
}

/// False once the publisher may have overwritten the memory: its pool reclaims memory that no
/// holder confirmed for 100 ms, even if it is referenced.
#[no_mangle]
pub unsafe extern "C" fn zloam_bytes_is_intact(bytes: *const Bytes) -> bool {
    (*bytes).0.as_shm().is_none_or(|memory| memory.is_valid())
}

#[no_mangle]
pub unsafe extern "C" fn zloam_bytes_view(bytes: *const Bytes, out: *mut Slice) -> bool {
    match contiguous(&(*bytes).0) {
        Some(slice) => {
            *out = slice;
            true
        }
        None => false,
    }
}

#[no_mangle]
pub unsafe extern "C" fn zloam_bytes_copy_to(bytes: *const Bytes, destination: *mut u8) {
    let mut next = destination;
    for slice in (*bytes).0.slices() {
        std::ptr::copy_nonoverlapping(slice.as_ptr(), next, slice.len());
        next = next.add(slice.len());
    }
}

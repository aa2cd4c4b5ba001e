//! A C ABI over Eclipse Zenoh: what the C++ of `services/common/zenoh` needs, and no more.
//!
//! Rules that hold for every function (the header `include/zloam_zenoh.h` repeats them for C):
//!  - Handles are opaque and boxed. `*_drop` takes null. Handles passed in are only borrowed,
//!    except by `*_drop`.
//!  - Nothing unwinds across the boundary: a panic becomes `Status::Panic`, the process lives.
//!  - The text of a failure is kept per thread and read with `zloam_last_error`.
//!  - A closure is (call, context, drop). `drop` is called exactly once, also when the function that
//!    took the closure fails, after the last call has returned, on any thread.
//!  - Dropping an entity undeclares it and waits for its running callbacks.
mod abi;
mod bytes;
mod config;
mod ending;
mod error;
mod liveliness;
mod pubsub;
mod query;
mod sample;
mod session;

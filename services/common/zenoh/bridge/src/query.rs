//! Queryables, the queries they receive, and get.
use crate::abi::{hand_out, shield, take_back, Context, DropFn, Slice};
use crate::bytes::Bytes;
use crate::error::{guard, Status};
use crate::pubsub::encoding_of;
use crate::sample::{with_view, Sample};
use crate::session::{key_expression, Session};
use std::ffi::c_void;
use std::time::Duration;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::Wait;

pub struct Queryable(zenoh::query::Queryable<()>);
pub struct Query(zenoh::query::Query);

/// Valid as long as the query, except `payload`, which becomes the caller's (null: none).
#[repr(C)]
pub struct QueryView {
    pub key: Slice,
    pub parameters: Slice,
    pub payload: *mut Bytes,
}
const _: () = assert!(std::mem::size_of::<QueryView>() == 40);

/// The callee owns the query and ends it with `zloam_query_drop`, on any thread.
pub type OnQuery = unsafe extern "C" fn(context: *mut c_void, query: *mut Query);
/// Either a sample, or the payload of an error reply, which the callee owns.
pub type OnReply =
    unsafe extern "C" fn(context: *mut c_void, sample: *const Sample, error: *mut Bytes);

/// The Rust closure around a C one.
pub fn reply_closure(
    call: OnReply,
    context: Context,
) -> impl Fn(zenoh::query::Reply) + Send + Sync + 'static {
    move |reply| {
        let context = context.pointer();
        // SAFETY: the header demands that `call` may run on any thread until `drop` was called.
        shield(|| match reply.result() {
            Ok(sample) => {
                with_view(sample, |view| unsafe { call(context, view, std::ptr::null_mut()) })
            }
            Err(error) => unsafe {
                call(context, std::ptr::null(), Bytes::boxed(error.payload().clone()))
            },
        });
    }
}

#[no_mangle]
pub unsafe extern "C" fn zloam_session_declare_queryable(
    session: *const Session,
    key: Slice,
    complete: bool,
    call: OnQuery,
    context: *mut c_void,
    drop: DropFn,
    out: *mut *mut Queryable,
) -> Status {
    let context = Context::new(context, drop);
    guard(|| {
        let queryable = (*session)
            .zenoh
            .declare_queryable(key_expression(key)?)
            .complete(complete)
            .callback(move |query| {
                let context = context.pointer();
                call(context, Box::into_raw(Box::new(Query(query))));
            })
            .wait()?;
        hand_out(out, Queryable(queryable));
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_queryable_drop(queryable: *mut Queryable) {
    take_back(queryable, |queryable| queryable.0.undeclare().wait_callbacks().wait());
}

#[no_mangle]
pub unsafe extern "C" fn zloam_query_view_of(query: *const Query, out: *mut QueryView) {
    let query = &(*query).0;
    *out = QueryView {
        key: Slice::of(query.key_expr().as_str().as_bytes()),
        parameters: Slice::of(query.parameters().as_str().as_bytes()),
        payload: match query.payload() {
            Some(bytes) => Bytes::boxed(bytes.clone()),
            None => std::ptr::null_mut(),
        },
    };
}

#[no_mangle]
pub unsafe extern "C" fn zloam_query_reply(
    query: *const Query,
    key: Slice,
    payload: *const Bytes,
    encoding: Slice,
    attachment: *const Bytes,
) -> Status {
    guard(|| {
        (*query)
            .0
            .reply(key_expression(key)?, Bytes::share(payload).unwrap_or_default())
            .encoding(encoding_of(encoding)?)
            .attachment(Bytes::share(attachment))
            .wait()
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_query_reply_error(
    query: *const Query,
    payload: *const Bytes,
) -> Status {
    guard(|| (*query).0.reply_err(Bytes::share(payload).unwrap_or_default()).wait())
}

#[no_mangle]
pub unsafe extern "C" fn zloam_query_drop(query: *mut Query) {
    take_back(query, |_| Ok(()));
}

/// Answers are not consolidated: all are wanted, even if several queryables answer with the same
/// key. `drop` is called after the last answer or the timeout.
#[no_mangle]
pub unsafe extern "C" fn zloam_session_get(
    session: *const Session,
    selector: Slice,
    payload: *const Bytes,
    timeout_ms: u64,
    target_all: bool,
    call: OnReply,
    context: *mut c_void,
    drop: DropFn,
) -> Status {
    let context = Context::new(context, drop);
    guard(|| {
        let target = if target_all { QueryTarget::All } else { QueryTarget::BestMatching };
        let get = (*session)
            .zenoh
            .get(selector.text()?)
            .timeout(Duration::from_millis(timeout_ms))
            .target(target)
            .consolidation(ConsolidationMode::None)
            .callback(reply_closure(call, context));
        match Bytes::share(payload) {
            Some(bytes) => get.payload(bytes).wait(),
            None => get.wait(),
        }
    })
}

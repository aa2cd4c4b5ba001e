//! Liveliness: tokens, subscribers to tokens, and queries for them.
use crate::abi::{hand_out, take_back, Context, DropFn, Slice};
use crate::error::{guard, Status};
use crate::pubsub::Subscriber;
use crate::query::{reply_closure, OnReply};
use crate::sample::{sample_closure, OnSample};
use crate::session::{key_expression, Session};
use std::ffi::c_void;
use std::time::Duration;
use zenoh::Wait;

pub struct Token(zenoh::liveliness::LivelinessToken);

#[no_mangle]
pub unsafe extern "C" fn zloam_session_declare_token(
    session: *const Session,
    key: Slice,
    out: *mut *mut Token,
) -> Status {
    guard(|| {
        let token = (*session).zenoh.liveliness().declare_token(key_expression(key)?).wait()?;
        hand_out(out, Token(token));
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_token_drop(token: *mut Token) {
    take_back(token, |token| token.0.undeclare().wait());
}

#[no_mangle]
pub unsafe extern "C" fn zloam_session_declare_liveliness_subscriber(
    session: *const Session,
    key: Slice,
    history: bool,
    call: OnSample,
    context: *mut c_void,
    drop: DropFn,
    out: *mut *mut Subscriber,
) -> Status {
    let context = Context::new(context, drop);
    guard(|| {
        let subscriber = (*session)
            .zenoh
            .liveliness()
            .declare_subscriber(key_expression(key)?)
            .history(history)
            .callback(sample_closure(call, context))
            .wait()?;
        hand_out(out, Subscriber(subscriber));
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_session_liveliness_get(
    session: *const Session,
    key: Slice,
    timeout_ms: u64,
    call: OnReply,
    context: *mut c_void,
    drop: DropFn,
) -> Status {
    let context = Context::new(context, drop);
    guard(|| {
        (*session)
            .zenoh
            .liveliness()
            .get(key_expression(key)?)
            .timeout(Duration::from_millis(timeout_ms))
            .callback(reply_closure(call, context))
            .wait()
    })
}

//! Publishers and subscribers.
use crate::abi::{hand_out, take_back, Context, DropFn, Slice};
use crate::bytes::Bytes;
use crate::ending::Ending;
use crate::error::{guard, Result, Status};
use crate::sample::{sample_closure, OnSample};
use crate::session::{key_expression, Session};
use std::ffi::c_void;
use std::sync::Arc;
use zenoh::bytes::Encoding;
use zenoh::matching::MatchingStatus;
use zenoh::qos::{CongestionControl, Priority, Reliability};
use zenoh::Wait;

pub struct Publisher(Arc<Ending>);

pub struct Subscriber(pub zenoh::pubsub::Subscriber<()>);

#[repr(C)]
pub struct PublisherOptions {
    pub encoding: Slice,
    pub congestion_control: u8,
    pub priority: u8,
    pub express: bool,
    pub reliable: bool,
}
const _: () = assert!(std::mem::size_of::<PublisherOptions>() == 24);

pub type OnMatching = unsafe extern "C" fn(context: *mut c_void, matching: bool);

impl PublisherOptions {
    fn congestion_control(&self) -> Result<CongestionControl> {
        match self.congestion_control {
            0 => Ok(CongestionControl::Drop),
            1 => Ok(CongestionControl::Block),
            other => Err(format!("congestion control {other} is unknown").into()),
        }
    }

    fn reliability(&self) -> Reliability {
        if self.reliable {
            Reliability::Reliable
        } else {
            Reliability::BestEffort
        }
    }
}

pub unsafe fn encoding_of(text: Slice) -> Result<Encoding> {
    Ok(if text.size == 0 { Encoding::default() } else { Encoding::from(text.text()?) })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_session_declare_publisher(
    session: *const Session,
    key: Slice,
    options: *const PublisherOptions,
    out: *mut *mut Publisher,
) -> Status {
    guard(|| {
        let options = &*options;
        let publisher = (*session)
            .zenoh
            .declare_publisher(key_expression(key)?)
            .encoding(encoding_of(options.encoding)?)
            .congestion_control(options.congestion_control()?)
            .priority(Priority::try_from(options.priority)?)
            .express(options.express)
            .reliability(options.reliability())
            .wait()?;
        let ending = Arc::new(Ending::new(publisher));
        (*session).end_before_close(Arc::downgrade(&ending));
        hand_out(out, Publisher(ending));
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_publisher_put(
    publisher: *const Publisher,
    payload: *const Bytes,
    attachment: *const Bytes,
) -> Status {
    guard(|| {
        (*publisher)
            .0
            .live()?
            .publisher
            .put(Bytes::share(payload).unwrap_or_default())
            .attachment(Bytes::share(attachment))
            .wait()
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_publisher_delete(publisher: *const Publisher) -> Status {
    guard(|| (*publisher).0.live()?.publisher.delete().wait())
}

#[no_mangle]
pub unsafe extern "C" fn zloam_publisher_matching(
    publisher: *const Publisher,
    out: *mut bool,
) -> Status {
    guard(|| {
        *out = (*publisher).0.live()?.publisher.matching_status().wait()?.matching();
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_publisher_on_matching(
    publisher: *const Publisher,
    call: OnMatching,
    context: *mut c_void,
    drop: DropFn,
) -> Status {
    let context = Context::new(context, drop);
    guard(|| {
        let live = (*publisher).0.live()?;
        let listener = live
            .publisher
            .matching_listener()
            .callback(move |status: MatchingStatus| {
                let context = &context;
                // SAFETY: the header demands that `call` may run on any thread.
                unsafe { call(context.pointer(), status.matching()) }
            })
            .wait()?;
        live.keep(listener);
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_publisher_drop(publisher: *mut Publisher) {
    take_back(publisher, |publisher| publisher.0.end());
}

#[no_mangle]
pub unsafe extern "C" fn zloam_session_put(
    session: *const Session,
    key: Slice,
    payload: *const Bytes,
    options: *const PublisherOptions,
) -> Status {
    guard(|| {
        let options = &*options;
        (*session)
            .zenoh
            .put(key_expression(key)?, Bytes::share(payload).unwrap_or_default())
            .encoding(encoding_of(options.encoding)?)
            .congestion_control(options.congestion_control()?)
            .priority(Priority::try_from(options.priority)?)
            .express(options.express)
            .reliability(options.reliability())
            .wait()
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_session_delete(session: *const Session, key: Slice) -> Status {
    guard(|| (*session).zenoh.delete(key_expression(key)?).wait())
}

#[no_mangle]
pub unsafe extern "C" fn zloam_session_declare_subscriber(
    session: *const Session,
    key: Slice,
    call: OnSample,
    context: *mut c_void,
    drop: DropFn,
    out: *mut *mut Subscriber,
) -> Status {
    let context = Context::new(context, drop);
    guard(|| {
        let subscriber = (*session)
            .zenoh
            .declare_subscriber(key_expression(key)?)
            .callback(sample_closure(call, context))
            .wait()?;
        hand_out(out, Subscriber(subscriber));
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_subscriber_drop(subscriber: *mut Subscriber) {
    take_back(subscriber, |subscriber| subscriber.0.undeclare().wait_callbacks().wait());
}

//! Zenoh's configuration.
use crate::abi::{hand_out, take_back, Slice};
use crate::error::{guard, Status};

pub struct Config(pub zenoh::Config);

#[no_mangle]
pub unsafe extern "C" fn zloam_config_default(out: *mut *mut Config) -> Status {
    guard(|| {
        hand_out(out, Config(zenoh::Config::default()));
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_config_from_text(json5: Slice, out: *mut *mut Config) -> Status {
    guard(|| {
        hand_out(out, Config(zenoh::Config::from_json5(json5.text()?)?));
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_config_from_file(path: Slice, out: *mut *mut Config) -> Status {
    guard(|| {
        hand_out(out, Config(zenoh::Config::from_file(path.text()?)?));
        Ok(())
    })
}

#[no_mangle]
pub unsafe extern "C" fn zloam_config_insert(
    config: *mut Config,
    key: Slice,
    json5: Slice,
) -> Status {
    guard(|| (*config).0.insert_json5(key.text()?, json5.text()?))
}

#[no_mangle]
pub unsafe extern "C" fn zloam_config_drop(config: *mut Config) {
    take_back(config, |_| Ok(()));
}

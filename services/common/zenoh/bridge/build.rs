//! Gives the shared library a name of its own, so that programs look it up by name and not by the
//! path it had when they were linked.
fn main() {
    println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,libzloam_zenoh.so");
    println!("cargo:rerun-if-changed=build.rs");
}

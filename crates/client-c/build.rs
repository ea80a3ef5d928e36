//! Name of the shared library for the loader: `libplumbline.so.MAJOR`, the name under which `install.sh` installs it.

fn main() {
    let major = std::env::var("CARGO_PKG_VERSION_MAJOR").expect("Cargo sets it");
    println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,libplumbline.so.{major}");
    println!("cargo:rerun-if-changed=build.rs");
}

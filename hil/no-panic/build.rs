//! Switches the product's `no_panic` attributes on.

fn main() {
    println!("cargo::rustc-cfg=no_panic");
}

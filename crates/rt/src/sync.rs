//! The atomics of the hand-overs under one name, so that a model checker can replace them (`hil/loom/`), and unit tests by those that
//! let another thread act between any two accesses of this one.

#[cfg(loom)]
pub(super) use loom::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
#[cfg(not(any(loom, test)))]
pub(super) use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
#[cfg(all(test, not(loom)))]
pub(super) use stepped::{AtomicBool, AtomicU32, AtomicU64, Ordering, act_before_access};

/// Atomics that run an action before one of this thread's accesses: what another thread may do at that moment.
#[cfg(all(test, not(loom)))]
mod stepped {
    use std::cell::RefCell;
    pub use std::sync::atomic::Ordering;

    type Action = Box<dyn FnOnce()>;

    thread_local! {
        static NEXT: RefCell<Option<(u32, Action)>> = const { RefCell::new(None) };
    }

    /// Runs `action` on this thread before its access number `access` from now on, counted from 0; one action at a time.
    pub fn act_before_access(access: u32, action: impl FnOnce() + 'static) {
        NEXT.with_borrow_mut(|next| *next = Some((access, Box::new(action))));
    }

    fn step() {
        let due = NEXT.with_borrow_mut(|next| match next {
            Some((0, _)) => next.take(),
            Some((left, _)) => {
                *left -= 1;
                None
            }
            None => None,
        });
        if let Some((_, action)) = due {
            action();
        }
    }

    macro_rules! stepped {
        ($name:ident, $value:ty) => {
            #[derive(Debug, Default)]
            pub struct $name(std::sync::atomic::$name);

            #[allow(dead_code)] // each is used as its value needs it
            impl $name {
                pub fn load(&self, order: Ordering) -> $value {
                    step();
                    self.0.load(order)
                }

                pub fn store(&self, value: $value, order: Ordering) {
                    step();
                    self.0.store(value, order);
                }

                pub fn swap(&self, value: $value, order: Ordering) -> $value {
                    step();
                    self.0.swap(value, order)
                }

                pub fn compare_exchange(
                    &self,
                    current: $value,
                    new: $value,
                    success: Ordering,
                    failure: Ordering,
                ) -> Result<$value, $value> {
                    step();
                    self.0.compare_exchange(current, new, success, failure)
                }
            }
        };
    }
    stepped!(AtomicBool, bool);
    stepped!(AtomicU32, u32);
    stepped!(AtomicU64, u64);

    impl AtomicU32 {
        pub fn fetch_add(&self, value: u32, order: Ordering) -> u32 {
            step();
            self.0.fetch_add(value, order)
        }
    }

    impl AtomicU64 {
        pub fn fetch_add(&self, value: u64, order: Ordering) -> u64 {
            step();
            self.0.fetch_add(value, order)
        }
    }
}

// The identified model in a controller's loop: C interface of plumbline. Made by cbindgen from crates/client-c; do not edit.

#ifndef PLUMBLINE_H
#define PLUMBLINE_H

#include <stddef.h>
#include <stdint.h>

// Result of a call. 1 to 19: of a call in the control loop, which then has written nothing.
typedef enum PlumblineCode {
  // Success.
  PLUMBLINE_OK = 0,
  // A pointer is null, or a text is not UTF-8.
  PLUMBLINE_ARGUMENT = 1,
  // No model has arrived yet.
  PLUMBLINE_NO_MODEL = 2,
  // An array has another length than the model needs.
  PLUMBLINE_LENGTH = 3,
  // A number of the input is infinite or NaN.
  PLUMBLINE_NOT_FINITE = 4,
  // The model has effects that are computed for its own gravity in advance.
  PLUMBLINE_FIXED_GRAVITY = 5,
  // The model is not valid under this gravity.
  PLUMBLINE_MOUNTING = 6,
  // The model file has no `[uncertainty]`.
  PLUMBLINE_NO_UNCERTAINTY = 7,
  // The queue of samples is full: the sample is lost, and counted.
  PLUMBLINE_QUEUE_FULL = 8,
  // No torque of the daemon has arrived yet.
  PLUMBLINE_NO_VALUE = 9,
  // A file or a name that can't be used.
  PLUMBLINE_INPUT = 20,
  // No daemon serves the robot.
  PLUMBLINE_NO_DAEMON = 21,
  // The daemon's messages have another layout.
  PLUMBLINE_LAYOUT = 22,
  // No slot is left for another client.
  PLUMBLINE_FULL = 23,
  // Shared memory failed.
  PLUMBLINE_TRANSPORT = 24,
  // The followed daemon has ended, or sends nothing; the last model is kept, and the next daemon is followed.
  PLUMBLINE_DAEMON_GONE = 25,
  // The daemon serves a model of another robot than expected.
  PLUMBLINE_OTHER_ROBOT = 26,
  // Gravity is not the expected one, or the model is not valid under it.
  PLUMBLINE_OTHER_MOUNTING = 27,
  // The served text is not that of the model that its header names.
  PLUMBLINE_DAMAGED = 28,
  // Another process publishes the states of this arm.
  PLUMBLINE_SECOND_PUBLISHER = 29,
  // A thread of the library failed.
  PLUMBLINE_THREAD = 30,
  // The library panicked: a bug. Free the handle, and use it for nothing else.
  PLUMBLINE_PANIC = 31,
} PlumblineCode;

// Client of the feed-forward torque of the daemon's own motion.
typedef struct PlumblineFeedForward PlumblineFeedForward;

// Publisher of the states of an arm that the caller controls.
typedef struct PlumblineGuest PlumblineGuest;

// The identified model of an arm's torques.
typedef struct PlumblineModel PlumblineModel;

// The model as the loop has it at this moment.
typedef struct PlumblineStatus {
  // Identity of the model that the next call uses, 0 for none.
  uint64_t model;
  // Time since the follower last found the daemon running [ns]; 0 for a file.
  uint64_t age_ns;
  // 0 none served yet, 1 valid, 3 withdrawn, 4 contradicted by the measured torques.
  uint32_t validity;
} PlumblineStatus;

// Feed-forward torque of the daemon's own motion in one cycle. Entries past the number of joints are zero.
typedef struct PlumblineTorque {
  // Number of the value since the daemon's start, from 1.
  uint64_t sequence;
  // Identity of the daemon's start.
  uint64_t epoch;
  // Identity of the served model, 0 for none.
  uint64_t model;
  // Time from the arm's state to this call [ns]; of a daemon on another machine, the part beyond the fastest transit of the last 5 to 10 s of values.
  uint64_t age_ns;
  // Number of joints.
  uint32_t n;
  // 0 none served yet, 1 valid, 2 on its way to the model's torque, 3 withdrawn, 4 contradicted by the measured torques.
  uint32_t validity;
  // 0 hold, 1 approach, 2 excite, 3 return, 4 stop, 5 stopped.
  uint32_t phase;
  // 1 where the torque may be used: a model is served, and the value is no older than the limit of plumbline_feed_forward_open. Else 0.
  uint32_t usable;
  // Desired position [rad].
  double q_d[8];
  // Desired velocity [rad/s].
  double dq_d[8];
  // Feed-forward torque [Nm].
  double tau[8];
  // Part of it that the arm's own controller adds [Nm]: send tau - tau_vendor.
  double tau_vendor[8];
  // Gravitational acceleration in the base frame [m/s2].
  double gravity[3];
  // Gravitational acceleration that the arm's own controller compensates [m/s2].
  double gravity_vendor[3];
} PlumblineTorque;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Text of a [`PlumblineCode`]. Never null, never freed.
const char *plumbline_text(int32_t code);

// Text of this thread's last error with a code of 20 or more, with its file, value or robot; valid until this thread's next call of this
// library. Not for the control loop.
const char *plumbline_last_error(void);

// The model of a file under `gravity`, 3 values in the base frame [m/s2].
//
// # Safety
// `path` ends with a zero, `gravity` has 3 values, `model` may be written to; any may be null.
enum PlumblineCode plumbline_model_load(const char *path, const double *gravity, struct PlumblineModel **model);

// The model that the daemon of `robot` serves, followed by a thread of the library. Waits up to `timeout_s` seconds for daemon and model.
// `expected_robot` and `expected_gravity` (3 values [m/s2]) may be null: anything is accepted.
//
// # Safety
// Texts end with a zero, `expected_gravity` has 3 values, `model` may be written to; any may be null.
enum PlumblineCode plumbline_model_follow(const char *robot,
                                          const char *expected_robot,
                                          const double *expected_gravity,
                                          double timeout_s,
                                          struct PlumblineModel **model);

// Frees a model; null is allowed.
//
// # Safety
// `model` is null or from this library, and not used afterwards.
void plumbline_model_free(struct PlumblineModel *model);

// What following the daemon has last failed at, PLUMBLINE_OK while it succeeds; its text by plumbline_last_error. Not for the control loop.
//
// # Safety
// `model` is null or from this library.
enum PlumblineCode plumbline_model_trouble(const struct PlumblineModel *model);

// Identity and validity of the model, and time since the daemon was found running.
//
// # Safety
// `model` is null or from this library, `status` is null or may be written to.
enum PlumblineCode plumbline_status(struct PlumblineModel *model, struct PlumblineStatus *status);

// Number of joints, and of columns of the regressor.
//
// # Safety
// `model` is null or from this library, `joints` and `columns` are null or may be written to.
enum PlumblineCode plumbline_sizes(struct PlumblineModel *model, uintptr_t *joints, uintptr_t *columns);

// Torque that the arm needs at a state, n values [Nm]: all terms of the model. Call it once per cycle. `gravity` is 3 values [m/s2], or null
// for the model's own.
//
// # Safety
// `model` is null or from this library; arrays are null or have n values, `gravity` 3. `tau` does not overlap the others.
enum PlumblineCode plumbline_torque(struct PlumblineModel *model,
                                    uintptr_t n,
                                    const double *q,
                                    const double *dq,
                                    const double *ddq,
                                    const double *gravity,
                                    double *tau);

// Torque of gravity at rest at `q` under the model's own gravity, n values [Nm].
//
// # Safety
// As plumbline_torque.
enum PlumblineCode plumbline_gravity(struct PlumblineModel *model, uintptr_t n, const double *q, double *tau);

// Centrifugal and Coriolis torques, n values [Nm].
//
// # Safety
// As plumbline_torque.
enum PlumblineCode plumbline_coriolis(struct PlumblineModel *model, uintptr_t n, const double *q, const double *dq, double *tau);

// Viscous and Coulomb friction, n values [Nm].
//
// # Safety
// As plumbline_torque.
enum PlumblineCode plumbline_friction(struct PlumblineModel *model, uintptr_t n, const double *dq, double *tau);

// Inertia matrix, n n values (symmetric) [kg m2].
//
// # Safety
// As plumbline_torque; `matrix` has n n values.
enum PlumblineCode plumbline_inertia(struct PlumblineModel *model, uintptr_t n, const double *q, double *matrix);

// Regressor Y with tau = Y beta, n p values, column after column; p is the number of columns by plumbline_sizes.
//
// # Safety
// As plumbline_torque; `y` has n p values.
enum PlumblineCode plumbline_regressor(struct PlumblineModel *model,
                                       uintptr_t n,
                                       uintptr_t p,
                                       const double *q,
                                       const double *dq,
                                       const double *ddq,
                                       double *y);

// Standard deviation of the model's torque by the covariance of its parameters, n values [Nm].
//
// # Safety
// As plumbline_torque.
enum PlumblineCode plumbline_torque_std(struct PlumblineModel *model,
                                        uintptr_t n,
                                        const double *q,
                                        const double *dq,
                                        const double *ddq,
                                        double *std);

// External torque, measured less modelled, 11 ms late: n values [Nm], half the width of their 95 % intervals [Nm], and in `contact` 1 where a joint
// exceeds its threshold (one false alarm in ten hours), else 0. Measured position [rad], velocity [rad/s] and torque [Nm]. Once per cycle.
//
// # Safety
// As plumbline_torque; `contact` is null or may be written to.
enum PlumblineCode plumbline_external(struct PlumblineModel *model,
                                      uintptr_t n,
                                      const double *q,
                                      const double *dq,
                                      const double *tau,
                                      double *tau_ext,
                                      double *half_width,
                                      uint32_t *contact);

// Connects to the daemon of `robot`, waiting up to `timeout_s` seconds for it. A value older than `stale_after_ms` is not usable.
//
// # Safety
// `robot` ends with a zero, `feed_forward` may be written to; either may be null.
enum PlumblineCode plumbline_feed_forward_open(const char *robot,
                                               uint64_t stale_after_ms,
                                               double timeout_s,
                                               struct PlumblineFeedForward **feed_forward);

// The latest value with its present age; PLUMBLINE_NO_VALUE before the first, and before the second of a daemon on another machine. The same value is returned until a newer one arrives. The first call
// after the daemon's start maps memory; later ones read it.
//
// # Safety
// `feed_forward` is null or from this library, `torque` is null or may be written to.
enum PlumblineCode plumbline_feed_forward_latest(struct PlumblineFeedForward *feed_forward,
                                                 struct PlumblineTorque *torque);

// PLUMBLINE_OK while the daemon's process (on another machine: the tunnel's) runs, else PLUMBLINE_DAEMON_GONE. Reads files: not for the control loop.
//
// # Safety
// `feed_forward` is null or from this library.
enum PlumblineCode plumbline_feed_forward_daemon(const struct PlumblineFeedForward *feed_forward);

// Frees a client; null is allowed.
//
// # Safety
// `feed_forward` is null or from this library, and not used afterwards.
void plumbline_feed_forward_free(struct PlumblineFeedForward *feed_forward);

// Opens the publisher of the states of `robot` with n joints. Needs no daemon.
//
// # Safety
// `robot` ends with a zero, `guest` may be written to; either may be null.
enum PlumblineCode plumbline_guest_open(const char *robot, uintptr_t n, struct PlumblineGuest **guest);

// Publishes the state of one cycle: measured position [rad], velocity [rad/s], torque [Nm], desired position [rad], n values each. For
// the control loop.
//
// # Safety
// `guest` is null or from this library; arrays are null or have n values.
enum PlumblineCode plumbline_guest_publish(struct PlumblineGuest *guest,
                                           uintptr_t n,
                                           const double *q,
                                           const double *dq,
                                           const double *tau,
                                           const double *q_d);

// Samples lost on this side so far; 0 for null.
//
// # Safety
// `guest` is null or from this library.
uint64_t plumbline_guest_lost(const struct PlumblineGuest *guest);

// Sends what is queued, and frees the publisher; null is allowed.
//
// # Safety
// `guest` is null or from this library, and not used afterwards.
void plumbline_guest_free(struct PlumblineGuest *guest);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* PLUMBLINE_H */

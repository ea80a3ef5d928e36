/* The shared library that clients of protocol versions 3 to 9 load from the robot: 30 functions that fill the caller's arrays.
 *
 * For tests of such clients against the emulator. Kinematics are the arm's (modified Denavit-Hartenberg parameters of Franka's
 * documentation). Dynamics are NOT: the mass matrix is a constant diagonal, Coriolis and gravity torques are zero. Signatures as in
 * libfranka's model library interface (github.com/frankarobotics/libfranka-common, library_interface). All matrices are column-major.
 *
 *   cc -shared -fPIC -O1 -o libfcimodels.so model_library.c -lm
 */
#include <math.h>
#include <string.h>

static const double A[7] = {0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088};
static const double D[7] = {0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0};
/* Twist as sine; cosines are 1 where it is 0, and 0 elsewhere. */
static const double SIN_ALPHA[7] = {0.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0};
static const double FLANGE = 0.107;

static void times(const double *a, const double *b, double *out) {
    double product[16];
    for (int column = 0; column < 4; column++)
        for (int row = 0; row < 4; row++) {
            double sum = 0.0;
            for (int k = 0; k < 4; k++) sum += a[4 * k + row] * b[4 * column + k];
            product[4 * column + row] = sum;
        }
    memcpy(out, product, sizeof product);
}

static void identity(double *out) {
    memset(out, 0, 16 * sizeof *out);
    for (int k = 0; k < 4; k++) out[5 * k] = 1.0;
}

/* Pose of frame `number`: 1 to 7 joints, 8 flange, 9 end effector. */
static void pose(int number, const double *q, const double *end_effector, double *out) {
    identity(out);
    for (int j = 0; j < (number < 7 ? number : 7); j++) {
        double s = sin(q[j]), c = cos(q[j]), sa = SIN_ALPHA[j], ca = sa == 0.0 ? 1.0 : 0.0;
        double step[16] = {c, s * ca, s * sa, 0.0, -s, c * ca, c * sa, 0.0, 0.0, -sa, ca, 0.0,
                           A[j], -sa * D[j], ca * D[j], 1.0};
        times(out, step, out);
    }
    if (number >= 8) {
        double flange[16];
        identity(flange);
        flange[14] = FLANGE;
        times(out, flange, out);
    }
    if (number == 9) times(out, end_effector, out);
}

/* Jacobian of frame `number` in the base's axes, or in its own. */
static void jacobian(int number, const double *q, const double *end_effector, int own, double *out) {
    double at[16];
    memset(out, 0, 42 * sizeof *out);
    pose(number, q, end_effector, at);
    for (int j = 0; j < (number < 7 ? number : 7); j++) {
        double frame[16], linear[3], *column = out + 6 * j;
        pose(j + 1, q, end_effector, frame);
        const double *z = frame + 8;
        double r[3] = {at[12] - frame[12], at[13] - frame[13], at[14] - frame[14]};
        for (int k = 0; k < 3; k++) linear[k] = z[(k + 1) % 3] * r[(k + 2) % 3] - z[(k + 2) % 3] * r[(k + 1) % 3];
        for (int k = 0; k < 3; k++)
            if (own) {
                const double *axis = at + 4 * k;
                column[k] = axis[0] * linear[0] + axis[1] * linear[1] + axis[2] * linear[2];
                column[3 + k] = axis[0] * z[0] + axis[1] * z[1] + axis[2] * z[2];
            } else {
                column[k] = linear[k];
                column[3 + k] = z[k];
            }
    }
}

static const double ZERO[7];

#define FRAME(N)                                                            \
    void O_T_J##N(const double *q, double *out) { pose(N, q, 0, out); }     \
    void O_J_J##N(const double *q, double *out) { jacobian(N, q, 0, 0, out); } \
    void Ji_J_J##N(const double *q, double *out) { jacobian(N, q, 0, 1, out); }

void O_T_J1(const double *q, double *out) { pose(1, q, 0, out); }
void O_J_J1(double *out) { jacobian(1, ZERO, 0, 0, out); }
void Ji_J_J1(double *out) { jacobian(1, ZERO, 0, 1, out); }
FRAME(2)
FRAME(3)
FRAME(4)
FRAME(5)
FRAME(6)
FRAME(7)
FRAME(8)
void O_T_J9(const double *q, const double *ee, double *out) { pose(9, q, ee, out); }
void O_J_J9(const double *q, const double *ee, double *out) { jacobian(9, q, ee, 0, out); }
void Ji_J_J9(const double *q, const double *ee, double *out) { jacobian(9, q, ee, 1, out); }

void M_NE(const double *q, const double *inertia, double mass, const double *com, double *out) {
    (void)q, (void)inertia, (void)mass, (void)com;
    memset(out, 0, 49 * sizeof *out);
    for (int j = 0; j < 7; j++) out[8 * j] = j < 4 ? 1.0 : 0.1;
}

void c_NE(const double *q, const double *dq, const double *inertia, double mass, const double *com, double *out) {
    (void)q, (void)dq, (void)inertia, (void)mass, (void)com;
    memset(out, 0, 7 * sizeof *out);
}

void g_NE(const double *q, const double *gravity, double mass, const double *com, double *out) {
    (void)q, (void)gravity, (void)mass, (void)com;
    memset(out, 0, 7 * sizeof *out);
}

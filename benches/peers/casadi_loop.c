/* Calls CasADi's generated functions in a loop, as a controller would. */
#include "timing.h"
#include "casadi_arm.h"

static double tau[7], y[7 * 45], work[4096];
static long long iw[256];

static void call(int (*f)(const double **, double **, casadi_int *, double *, int), int k, double *out) {
    const double *in[3] = {sample_q[k], sample_dq[k], sample_ddq[k]};
    double *res[1] = {out};
    f(in, res, (casadi_int *)iw, work, 0);
}

int main(void) {
    draw_samples();
    TIME("torque-rigid\tCasADi C", 2000, call(rigid, k, tau));
    TIME("torque-whole\tCasADi C", 2000, call(whole, k, tau));
    TIME("regressor-45\tCasADi C", 2000, call(base_regressor, k, y));
    fprintf(stderr, "%g %g\n", tau[3], y[100]);
    return 0;
}

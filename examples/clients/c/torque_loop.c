// A control loop in plain C: the torque of a model file along a slow sine, as a controller would send it.
//
//     cc torque_loop.c $(pkg-config --cflags --libs plumbline) -lm -o torque_loop && ./torque_loop MODEL.toml
#include <math.h>
#include <stdio.h>

#include "plumbline.h"

enum { N = 7, CYCLES = 1000 };

int main(int argc, char **argv) {
    if (argc != 2) {
        fprintf(stderr, "usage: %s MODEL.toml\n", argv[0]);
        return 2;
    }
    const double gravity[3] = {0.0, 0.0, -9.81};
    PlumblineModel *model = NULL;
    if (plumbline_model_load(argv[1], gravity, &model) != PLUMBLINE_OK) {
        fprintf(stderr, "%s\n", plumbline_last_error());
        return 1;
    }
    double q[N] = {0.0}, dq[N] = {0.0}, ddq[N] = {0.0}, tau[N] = {0.0};
    for (int cycle = 0; cycle < CYCLES; cycle++) {
        const double w = 2.0, t = 1e-3 * cycle;
        for (int j = 0; j < N; j++) {
            q[j] = 0.1 * sin(w * t);
            dq[j] = 0.1 * w * cos(w * t);
            ddq[j] = -0.1 * w * w * sin(w * t);
        }
        const PlumblineCode code = plumbline_torque(model, N, q, dq, ddq, NULL, tau);
        if (code != PLUMBLINE_OK) {
            fprintf(stderr, "cycle %d: %s\n", cycle, plumbline_text(code));
            plumbline_model_free(model);
            return 1;
        }
        // Here a controller adds its feedback and sends the sum.
    }
    for (int j = 0; j < N; j++) printf("%.17g\n", tau[j]);
    plumbline_model_free(model);
    return 0;
}

/* Least time of one call over `repeats` passes through the states of an arm with 7 joints [ns]: MODEL STATES REPEATS. */
#include "plumbline.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { N = 7, STATES = 1000 };

static double now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

int main(int argc, char **argv) {
    static double states[STATES][3][N];
    const double gravity[3] = {9.81, 0.0, 0.0};
    PlumblineModel *model = NULL;
    FILE *file = argc == 4 ? fopen(argv[2], "rb") : NULL;
    if (file == NULL || fread(states, sizeof states, 1, file) != 1) return 2;
    if (plumbline_model_load(argv[1], gravity, &model) != PLUMBLINE_OK) return 1;
    double least = 1e12, tau[N], sum = 0.0;
    for (int repeat = 0; repeat < atoi(argv[3]); repeat++) {
        const double start = now_ns();
        for (int k = 0; k < STATES; k++) {
            if (plumbline_torque(model, N, states[k][0], states[k][1], states[k][2], NULL, tau) != PLUMBLINE_OK) return 1;
            sum += tau[0];
        }
        const double each = (now_ns() - start) / STATES;
        if (each < least) least = each;
    }
    printf("%.2f %g\n", least, sum);
    plumbline_model_free(model);
    return 0;
}

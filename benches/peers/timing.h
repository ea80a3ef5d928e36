/* Shared by the peers: random samples from one seed, least time per call over repeats. */
#ifndef TIMING_H
#define TIMING_H
#include <stdio.h>
#include <time.h>

#define SAMPLES 64
#define REPEATS 200

static double sample_q[SAMPLES][7], sample_dq[SAMPLES][7], sample_ddq[SAMPLES][7];

static double now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static void draw_samples(void) {
    unsigned long long state = 88172645463325252ull;
    for (int k = 0; k < SAMPLES; k++)
        for (int j = 0; j < 7; j++) {
            double *targets[3] = {&sample_q[k][j], &sample_dq[k][j], &sample_ddq[k][j]};
            double spans[3] = {2.5, 2.0, 5.0};
            for (int i = 0; i < 3; i++) {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                *targets[i] = spans[i] * (2.0 * (double)(state >> 11) / 9007199254740992.0 - 1.0);
            }
        }
}

/* The body sees `k`, the number of the sample. */
#define TIME(name, calls, body)                                                   \
    do {                                                                          \
        double least = 1e300;                                                     \
        for (int repeat = 0; repeat < REPEATS; repeat++) {                        \
            double start = now_ns();                                              \
            for (int turn = 0; turn < (calls); turn++) {                          \
                int k = turn % SAMPLES;                                           \
                body;                                                             \
            }                                                                     \
            double each = (now_ns() - start) / (calls);                           \
            if (each < least) least = each;                                       \
        }                                                                         \
        printf("%s\t%.1f\n", name, least);                                        \
    } while (0)

#endif

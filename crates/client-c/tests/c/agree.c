/* Reads the states of an arm with n joints from standard input (q, dq, ddq as doubles) and writes the torques: MODEL n. Then checks every
   error that a caller can make. */
#include "plumbline.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(condition) if (!(condition)) { fprintf(stderr, "line %d: %s\n", __LINE__, #condition); return 1; }

int main(int argc, char **argv) {
    CHECK(argc == 3);
    const double gravity[3] = {9.81, 0.0, 0.0};
    const size_t n = (size_t)atoi(argv[2]);
    size_t joints = 0, columns = 0;
    double state[24], tau[8];
    PlumblineModel *model = NULL;
    CHECK(plumbline_model_load(argv[1], gravity, &model) == PLUMBLINE_OK);
    CHECK(plumbline_sizes(model, &joints, &columns) == PLUMBLINE_OK && joints == n && columns > n);
    while (fread(state, sizeof(double), 3 * n, stdin) == 3 * n) {
        CHECK(plumbline_torque(model, n, state, state + n, state + 2 * n, NULL, tau) == PLUMBLINE_OK);
        CHECK(fwrite(tau, sizeof(double), n, stdout) == n);
    }
    CHECK(plumbline_torque(NULL, n, state, state, state, NULL, tau) == PLUMBLINE_ARGUMENT);
    CHECK(plumbline_torque(model, n, NULL, state, state, NULL, tau) == PLUMBLINE_ARGUMENT);
    CHECK(plumbline_torque(model, n + 1, state, state, state, NULL, tau) == PLUMBLINE_LENGTH);
    state[0] = NAN;
    CHECK(plumbline_torque(model, n, state, state, state, NULL, tau) == PLUMBLINE_NOT_FINITE);
    PlumblineModel *none = NULL;
    CHECK(plumbline_model_load("no/such/file", gravity, &none) == PLUMBLINE_INPUT && none == NULL);
    CHECK(strstr(plumbline_last_error(), "no/such/file") != NULL);
    CHECK(plumbline_model_load("\xff", gravity, &none) == PLUMBLINE_ARGUMENT);
    CHECK(plumbline_model_follow("nobody-serves-this", NULL, NULL, 0.0, &none) == PLUMBLINE_NO_DAEMON);
    CHECK(plumbline_model_follow("panda", NULL, NULL, NAN, &none) == PLUMBLINE_ARGUMENT);
    CHECK(strstr(plumbline_text(PLUMBLINE_PANIC), "panicked") != NULL && strcmp(plumbline_text(-1), "unknown code") == 0);
    plumbline_model_free(NULL);
    plumbline_model_free(model);
    return 0;
}

// Prints the feed-forward torque of the daemon's own motion, a line per new value, as examples/clients/python/torque_follow.py does.
//
//     cc torque_follow.c $(pkg-config --cflags --libs plumbline) -o torque_follow && ./torque_follow ROBOT VALUES
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "plumbline.h"

int main(int argc, char **argv) {
    if (argc != 3) {
        fprintf(stderr, "usage: %s ROBOT VALUES\n", argv[0]);
        return 2;
    }
    PlumblineFeedForward *feed_forward = NULL;
    if (plumbline_feed_forward_open(argv[1], 5, 5.0, &feed_forward) != PLUMBLINE_OK) {
        fprintf(stderr, "%s\n", plumbline_last_error());
        return 1;
    }
    const struct timespec pause = {0, 200000};
    uint64_t last = 0;
    PlumblineCode code = PLUMBLINE_OK;
    for (long printed = 0; printed < atol(argv[2]);) {
        PlumblineTorque torque;
        code = plumbline_feed_forward_latest(feed_forward, &torque);
        if (code != PLUMBLINE_OK && code != PLUMBLINE_NO_VALUE) {
            fprintf(stderr, "%s\n", plumbline_last_error());
            break;
        }
        if (code == PLUMBLINE_OK && torque.sequence != last) {
            printf("seq %" PRIu64 "  age %.3f ms  model %016" PRIx64 "  tau", torque.sequence, 1e-6 * (double)torque.age_ns, torque.model);
            // A torque that is not usable must not be sent.
            for (uint32_t j = 0; j < torque.n; j++) printf(" %9.4f", torque.tau[j]);
            printf("%s\n", torque.usable ? "" : "  NOT USABLE");
            last = torque.sequence;
            printed++;
        } else if (plumbline_feed_forward_daemon(feed_forward) != PLUMBLINE_OK) {
            fprintf(stderr, "the daemon has ended\n");
            break;
        }
        // A control loop calls once per cycle instead.
        nanosleep(&pause, NULL);
    }
    plumbline_feed_forward_free(feed_forward);
    return code == PLUMBLINE_OK ? 0 : 1;
}

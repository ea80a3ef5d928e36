/* Codes and texts of everything that is opened from the daemon of ROBOT, a line each. */
#define _POSIX_C_SOURCE 199309L

#include "plumbline.h"

#include <stdio.h>
#include <time.h>

enum { TRIES = 500 };

static void print(const char *what, PlumblineCode code) {
    printf("%s %d %s\n", what, (int)code, code == PLUMBLINE_OK ? "" : plumbline_last_error());
}

int main(int argc, char **argv) {
    if (argc != 2) return 2;
    PlumblineModel *model = NULL;
    PlumblineFeedForward *feed_forward = NULL;
    PlumblineGuest *guest = NULL;
    print("follow", plumbline_model_follow(argv[1], NULL, NULL, 0.2, &model));
    if (model != NULL) {
        /* The daemon sends what it has when it sees the new subscriber. */
        PlumblineCode trouble = plumbline_model_trouble(model);
        for (int tried = 0; tried < TRIES && trouble == PLUMBLINE_OK; tried++) {
            const struct timespec pause = {.tv_sec = 0, .tv_nsec = 10 * 1000 * 1000};
            nanosleep(&pause, NULL);
            trouble = plumbline_model_trouble(model);
        }
        print("trouble", trouble);
    }
    print("feed-forward", plumbline_feed_forward_open(argv[1], 5, 0.2, &feed_forward));
    print("guest", plumbline_guest_open(argv[1], 7, &guest));
    plumbline_model_free(model);
    plumbline_feed_forward_free(feed_forward);
    plumbline_guest_free(guest);
    return 0;
}

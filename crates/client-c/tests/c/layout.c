/* Codes and texts of everything that is opened from the daemon of ROBOT, a line each. */
#include "plumbline.h"

#include <stdio.h>

static void print(const char *what, PlumblineCode code) {
    printf("%s %d %s\n", what, (int)code, code == PLUMBLINE_OK ? "" : plumbline_last_error());
}

int main(int argc, char **argv) {
    if (argc != 2) return 2;
    PlumblineModel *model = NULL;
    PlumblineFeedForward *feed_forward = NULL;
    PlumblineGuest *guest = NULL;
    print("follow", plumbline_model_follow(argv[1], NULL, NULL, 0.2, &model));
    if (model != NULL) print("trouble", plumbline_model_trouble(model));
    print("feed-forward", plumbline_feed_forward_open(argv[1], 5, 0.2, &feed_forward));
    print("guest", plumbline_guest_open(argv[1], 7, &guest));
    plumbline_model_free(model);
    plumbline_feed_forward_free(feed_forward);
    plumbline_guest_free(guest);
    return 0;
}

// Prints the latest feed-forward torque of ROBOT once it has number SEQUENCE: number, model, joints, validity, phase, usable, age below an hour, last
// joint's position, torque, vendor torque, gravity. Then waits for the end of standard input, and prints whether the daemon runs.
#include "plumbline.hpp"

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <thread>

int main(int argc, char **argv) {
    if (argc != 3) return 2;
    try {
        plumbline::FeedForward feed_forward(argv[1], 3600000);
        PlumblineTorque torque{};
        while (feed_forward.latest(torque) == PLUMBLINE_NO_VALUE || torque.sequence < std::strtoull(argv[2], nullptr, 10))
            std::this_thread::sleep_for(std::chrono::microseconds(200));
        const auto j = torque.n - 1;
        for (double value : {double(torque.sequence), double(torque.model), double(torque.n), double(torque.validity), double(torque.phase),
                             double(torque.usable), double(torque.age_ns < 3600000000000u), torque.q_d[j], torque.tau[j],
                             torque.tau_vendor[j], torque.gravity[0], torque.gravity_vendor[2], double(feed_forward.running())})
            std::printf("%.17g\n", value);
        PlumblineFeedForward *none = nullptr;
        if (plumbline_feed_forward_latest(nullptr, &torque) != PLUMBLINE_ARGUMENT) return 3;
        if (plumbline_feed_forward_open("nobody-serves-this", 5, 0.0, &none) != PLUMBLINE_NO_DAEMON) return 3;
        if (plumbline_feed_forward_open("No Robot", 5, 0.0, &none) != PLUMBLINE_INPUT || none != nullptr) return 3;
        if (plumbline_feed_forward_daemon(nullptr) != PLUMBLINE_ARGUMENT) return 3;
        plumbline_feed_forward_free(nullptr);
    } catch (const plumbline::Error &error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
    return 0;
}

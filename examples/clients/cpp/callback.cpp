// A torque callback in libfranka's style: state in, torque out. libfranka adds gravity upright by itself, so it is sent the difference to the
// torque of gravity under that mounting.
//
//     c++ -std=c++17 callback.cpp $(pkg-config --cflags --libs plumbline) -o callback && ./callback MODEL.toml
#include <cstdio>
#include <exception>

#include "plumbline.hpp"

namespace {

using Vector = std::array<double, 7>;

// What the callback uses of franka::RobotState and franka::Torques.
struct RobotState {
    Vector q_d, dq_d, ddq_d;
};
struct Torques {
    Vector tau_J;
    bool motion_finished;
};

template <typename Callback>
Torques control(Callback callback) {
    RobotState state{};
    Torques command{};
    do {
        state.q_d.fill(0.001 * (state.q_d[0] < 0.1 ? 1 : 0) + state.q_d[0]);
        command = callback(state);
    } while (!command.motion_finished && state.q_d[0] < 0.1);
    return command;
}

} // namespace

int main(int argc, char **argv) try {
    if (argc != 2) return 2;
    const std::array<double, 3> wall{9.81, 0.0, 0.0}, upright{0.0, 0.0, -9.81};
    auto model = plumbline::Model<7>::load(argv[1], wall);
    auto vendor = plumbline::Model<7>::load(argv[1], upright);
    const Torques last = control([&](const RobotState &state) -> Torques {
        Torques command{};
        Vector compensated{};
        const bool ok = model.torque(state.q_d, state.dq_d, state.ddq_d, command.tau_J) == PLUMBLINE_OK &&
                        vendor.gravity(state.q_d, compensated) == PLUMBLINE_OK;
        // Without a torque of the model the motion ends.
        command.motion_finished = !ok;
        for (std::size_t j = 0; j < 7; j++) command.tau_J[j] -= compensated[j];
        return command;
    });
    if (last.motion_finished) return 1;
    for (const double tau : last.tau_J) std::printf("%.17g\n", tau);
    return 0;
} catch (const std::exception &error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}

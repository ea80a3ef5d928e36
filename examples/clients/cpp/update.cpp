// A controller in ros2_control's style: configure outside the loop, update() in it. It follows the daemon's model and publishes its states.
//
//     c++ -std=c++17 update.cpp $(pkg-config --cflags --libs plumbline) -o update && ./update ROBOT
#include <chrono>
#include <cstdio>
#include <exception>
#include <optional>
#include <thread>

#include "plumbline.hpp"

namespace {

using Vector = std::array<double, 7>;

enum class Return { OK, ERROR };

class ModelController {
public:
    // Waits for the daemon and its model.
    Return on_configure(const std::string &robot) {
        model_.emplace(plumbline::Model<7>::follow(robot, 10.0, "panda"));
        guest_.emplace(robot);
        if (model_->status().validity == 0) {
            std::fprintf(stderr, "%s: no model within 10 s\n", robot.c_str());
            model_->check_daemon();
            return Return::ERROR;
        }
        return Return::OK;
    }

    // One cycle: no allocation, no lock, no exception.
    Return update(const Vector &q, const Vector &dq, const Vector &measured, const Vector &ddq_d, Vector &command) noexcept {
        // A lost sample is counted, and is no reason to stop.
        guest_->publish(q, dq, measured, q);
        return model_->torque(q, dq, ddq_d, command) == PLUMBLINE_OK ? Return::OK : Return::ERROR;
    }

    uint64_t lost() const { return guest_->lost(); }

private:
    std::optional<plumbline::Model<7>> model_;
    std::optional<plumbline::Guest<7>> guest_;
};

} // namespace

int main(int argc, char **argv) try {
    if (argc != 2) return 2;
    ModelController controller;
    if (controller.on_configure(argv[1]) != Return::OK) return 1;
    Vector q{}, dq{}, ddq{}, measured{}, command{};
    for (int cycle = 0; cycle < 100; cycle++) {
        q.fill(0.001 * cycle);
        if (controller.update(q, dq, measured, ddq, command) != Return::OK) return 1;
        measured = command;
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    for (const double tau : command) std::printf("%.17g\n", tau);
    return controller.lost() == 0 ? 0 : 1;
} catch (const std::exception &error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}

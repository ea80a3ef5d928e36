// The identified model in a controller's loop: C++17 around plumbline.h, without allocation and without exceptions in the loop.
#ifndef PLUMBLINE_HPP
#define PLUMBLINE_HPP

#include "plumbline.h"

#include <array>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>

namespace plumbline {

// Error of a call outside the control loop.
class Error : public std::runtime_error {
public:
    Error(PlumblineCode code, const std::string &text) : std::runtime_error(text), code_(code) {}

    PlumblineCode code() const noexcept { return code_; }

private:
    PlumblineCode code_;
};

inline void check(PlumblineCode code) {
    if (code != PLUMBLINE_OK) throw Error(code, code >= PLUMBLINE_INPUT ? plumbline_last_error() : plumbline_text(code));
}

// The model of an arm with N joints. Methods that are noexcept are for the control loop; they write nothing unless they return PLUMBLINE_OK.
template <std::size_t N>
class Model {
public:
    using Vector = std::array<double, N>;

    // The model of a file under `gravity` in the base frame [m/s2].
    static Model load(const std::string &path, const std::array<double, 3> &gravity) {
        PlumblineModel *model = nullptr;
        check(plumbline_model_load(path.c_str(), gravity.data(), &model));
        return Model(model);
    }

    // The model that the daemon of `robot` serves. An empty `expected_robot` and a null `expected_gravity` accept any.
    static Model follow(const std::string &robot, double timeout_s, const std::string &expected_robot = "",
                        const std::array<double, 3> *expected_gravity = nullptr) {
        PlumblineModel *model = nullptr;
        const char *expected = expected_robot.empty() ? nullptr : expected_robot.c_str();
        const double *gravity = expected_gravity ? expected_gravity->data() : nullptr;
        check(plumbline_model_follow(robot.c_str(), expected, gravity, timeout_s, &model));
        return Model(model);
    }

    // All terms of the model [Nm]; once per cycle.
    PlumblineCode torque(const Vector &q, const Vector &dq, const Vector &ddq, Vector &tau) noexcept {
        return plumbline_torque(model_.get(), N, q.data(), dq.data(), ddq.data(), nullptr, tau.data());
    }

    // As above, under another gravity than the model's own [m/s2].
    PlumblineCode torque(const Vector &q, const Vector &dq, const Vector &ddq, const std::array<double, 3> &gravity,
                         Vector &tau) noexcept {
        return plumbline_torque(model_.get(), N, q.data(), dq.data(), ddq.data(), gravity.data(), tau.data());
    }

    PlumblineCode gravity(const Vector &q, Vector &tau) noexcept {
        return plumbline_gravity(model_.get(), N, q.data(), tau.data());
    }

    PlumblineCode coriolis(const Vector &q, const Vector &dq, Vector &tau) noexcept {
        return plumbline_coriolis(model_.get(), N, q.data(), dq.data(), tau.data());
    }

    PlumblineCode friction(const Vector &dq, Vector &tau) noexcept {
        return plumbline_friction(model_.get(), N, dq.data(), tau.data());
    }

    PlumblineCode inertia(const Vector &q, std::array<double, N * N> &matrix) noexcept {
        return plumbline_inertia(model_.get(), N, q.data(), matrix.data());
    }

    PlumblineCode torque_std(const Vector &q, const Vector &dq, const Vector &ddq, Vector &std) noexcept {
        return plumbline_torque_std(model_.get(), N, q.data(), dq.data(), ddq.data(), std.data());
    }

    PlumblineCode external(const Vector &q, const Vector &dq, const Vector &tau, Vector &tau_ext, Vector &half_width,
                           bool &contact) noexcept {
        std::uint32_t flag = 0;
        const PlumblineCode code = plumbline_external(model_.get(), N, q.data(), dq.data(), tau.data(), tau_ext.data(),
                                                      half_width.data(), &flag);
        contact = flag != 0;
        return code;
    }

    PlumblineStatus status() noexcept {
        PlumblineStatus status{};
        plumbline_status(model_.get(), &status);
        return status;
    }

    // Throws what following the daemon has last failed at.
    void check_daemon() const { check(plumbline_model_trouble(model_.get())); }

private:
    struct Free {
        void operator()(PlumblineModel *model) const noexcept { plumbline_model_free(model); }
    };

    explicit Model(PlumblineModel *model) : model_(model) {}

    std::unique_ptr<PlumblineModel, Free> model_;
};

// Publisher of the states of an arm with N joints that the caller controls.
template <std::size_t N>
class Guest {
public:
    using Vector = std::array<double, N>;

    explicit Guest(const std::string &robot) {
        PlumblineGuest *guest = nullptr;
        check(plumbline_guest_open(robot.c_str(), N, &guest));
        guest_.reset(guest);
    }

    PlumblineCode publish(const Vector &q, const Vector &dq, const Vector &tau, const Vector &q_d) noexcept {
        return plumbline_guest_publish(guest_.get(), N, q.data(), dq.data(), tau.data(), q_d.data());
    }

    uint64_t lost() const noexcept { return plumbline_guest_lost(guest_.get()); }

private:
    struct Free {
        void operator()(PlumblineGuest *guest) const noexcept { plumbline_guest_free(guest); }
    };

    std::unique_ptr<PlumblineGuest, Free> guest_;
};

// Client of the feed-forward torque of the daemon's own motion.
class FeedForward {
public:
    explicit FeedForward(const std::string &robot, uint64_t stale_after_ms = 5, double timeout_s = 5.0) {
        PlumblineFeedForward *feed_forward = nullptr;
        check(plumbline_feed_forward_open(robot.c_str(), stale_after_ms, timeout_s, &feed_forward));
        feed_forward_.reset(feed_forward);
    }

    // The latest value with its present age; PLUMBLINE_NO_VALUE before the first.
    PlumblineCode latest(PlumblineTorque &torque) noexcept {
        return plumbline_feed_forward_latest(feed_forward_.get(), &torque);
    }

    // Whether the daemon's process runs. Reads files.
    bool running() const noexcept { return plumbline_feed_forward_daemon(feed_forward_.get()) == PLUMBLINE_OK; }

private:
    struct Free {
        void operator()(PlumblineFeedForward *feed_forward) const noexcept { plumbline_feed_forward_free(feed_forward); }
    };

    std::unique_ptr<PlumblineFeedForward, Free> feed_forward_;
};

} // namespace plumbline

#endif

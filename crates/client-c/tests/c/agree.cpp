// As agree.c, with the C++ wrapper: MODEL; the compiler's command line defines JOINTS.
#include "plumbline.hpp"

#include <cstdio>

constexpr std::size_t N = JOINTS;

int main(int argc, char **argv) {
    if (argc != 2) return 2;
    auto model = plumbline::Model<N>::load(argv[1], {9.81, 0.0, 0.0});
    std::array<double, 3 * N> state;
    while (std::fread(state.data(), sizeof(double), state.size(), stdin) == state.size()) {
        std::array<double, N> q, dq, ddq, tau;
        for (std::size_t j = 0; j < N; j++) q[j] = state[j], dq[j] = state[N + j], ddq[j] = state[2 * N + j];
        if (model.torque(q, dq, ddq, tau) != PLUMBLINE_OK || std::fwrite(tau.data(), sizeof(double), N, stdout) != N) return 1;
    }
    try {
        plumbline::Model<N>::load("no/such/file", {9.81, 0.0, 0.0});
    } catch (const plumbline::Error &error) {
        return error.code() == PLUMBLINE_INPUT ? 0 : 1;
    }
    return 1;
}

// Pinocchio's torque, regressor, and the stacking and solving of 10,000 samples.
#include <pinocchio/multibody/model.hpp>
#include <pinocchio/multibody/data.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <pinocchio/algorithm/regressor.hpp>
#include <Eigen/Cholesky>
#include <cmath>
#include <vector>
#include "timing.h"

namespace pin = pinocchio;

static pin::Model panda() {
    const double rows[7][3] = {{0, 0, 0.333},          {0, -M_PI_2, 0},      {0, M_PI_2, 0.316}, {0.0825, M_PI_2, 0},
                               {-0.0825, -M_PI_2, 0.384}, {0, M_PI_2, 0}, {0.088, M_PI_2, 0}};
    pin::Model model;
    model.gravity.linear(Eigen::Vector3d(9.81, 0, 0));
    pin::JointIndex parent = 0;
    for (int i = 0; i < 7; i++) {
        Eigen::Matrix3d twist = Eigen::AngleAxisd(rows[i][1], Eigen::Vector3d::UnitX()).toRotationMatrix();
        Eigen::Vector3d origin(rows[i][0], -std::sin(rows[i][1]) * rows[i][2], std::cos(rows[i][1]) * rows[i][2]);
        parent = model.addJoint(parent, pin::JointModelRZ(), pin::SE3(twist, origin), "joint" + std::to_string(i + 1));
        model.appendBodyToJoint(parent, pin::Inertia(3.0 - 0.3 * i, Eigen::Vector3d(0.02, -0.03, 0.05),
                                                     Eigen::Vector3d(0.03, 0.02, 0.01).asDiagonal()));
    }
    return model;
}

// CPU time, as for ours: what takes milliseconds is interrupted on a machine with other work.
static double cpu_ns() {
    timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return 1e9 * static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_nsec);
}

int main() {
    draw_samples();
    const pin::Model model = panda();
    pin::Data data(model);
    std::vector<Eigen::VectorXd> q, dq, ddq;
    for (int k = 0; k < SAMPLES; k++) {
        q.push_back(Eigen::Map<Eigen::VectorXd>(sample_q[k], 7));
        dq.push_back(Eigen::Map<Eigen::VectorXd>(sample_dq[k], 7));
        ddq.push_back(Eigen::Map<Eigen::VectorXd>(sample_ddq[k], 7));
    }
    TIME("torque-rigid\tPinocchio C++", 2000, pin::rnea(model, data, q[k], dq[k], ddq[k]));
    TIME("regressor-70\tPinocchio C++", 1000, pin::computeJointTorqueRegressor(model, data, q[k], dq[k], ddq[k]));

    // The base columns and friction of every sample, one under the other; then normal equations.
    std::vector<int> kept;
    for (int i = 0; i < 7; i++)
        // Pinocchio orders m, m c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
        for (int c : {1, 2, 4, 5, 7, 8, 9})
            if (i > 0 || c == 1 || c == 2 || c == 9) kept.push_back(10 * i + c);
    const int samples = 10000, columns = 59;
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> w(7 * samples, columns);
    w.setZero();
    Eigen::VectorXd tau = Eigen::VectorXd::Random(7 * samples);
    double stack = 1e300, solve = 1e300;
    for (int repeat = 0; repeat < 10; repeat++) {
        double start = cpu_ns();
        for (int k = 0; k < samples; k++) {
            const int s = k % SAMPLES;
            pin::computeJointTorqueRegressor(model, data, q[s], dq[s], ddq[s]);
            for (int j = 0; j < 7; j++) {
                auto row = w.row(7 * k + j);
                for (size_t c = 0; c < kept.size(); c++) row[c] = data.jointTorqueRegressor(j, kept[c]);
                row[45 + j] = dq[s][j];
                row[52 + j] = std::tanh(100 * dq[s][j]);
            }
        }
        stack = std::min(stack, cpu_ns() - start);
        start = cpu_ns();
        Eigen::MatrixXd m = Eigen::MatrixXd::Zero(columns, columns);
        m.selfadjointView<Eigen::Lower>().rankUpdate(w.transpose());
        Eigen::VectorXd beta = m.selfadjointView<Eigen::Lower>().ldlt().solve(w.transpose() * tau);
        solve = std::min(solve, cpu_ns() - start);
        fprintf(stderr, "%g\n", beta[0]);
    }
    printf("stack-10000\tPinocchio C++\t%.1f\n", stack);
    printf("solve-10000\tPinocchio C++ (Eigen, normal equations)\t%.1f\n", solve);
    return 0;
}

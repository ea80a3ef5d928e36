/* MuJoCo's inverse dynamics of the same arm: mujoco_arm MODEL.xml (written by the program itself). */
#include <math.h>
#include <string.h>
#include <mujoco/mujoco.h>
#include "timing.h"

int main(int argc, char **argv) {
    const double rows[7][3] = {{0, 0, 0.333},          {0, -1, 0},   {0, 1, 0.316}, {0.0825, 1, 0},
                               {-0.0825, -1, 0.384}, {0, 1, 0}, {0.088, 1, 0}};
    if (argc != 2) return 2;
    FILE *file = fopen(argv[1], "w");
    if (!file) return 2;
    fprintf(file, "<mujoco><compiler angle='radian'/><option gravity='9.81 0 0'><flag contact='disable' constraint='disable'/>"
                  "</option><worldbody>");
    for (int i = 0; i < 7; i++) {
        const double half = rows[i][1] * M_PI / 4;
        fprintf(file, "<body pos='%g %g %g' quat='%.17g %.17g 0 0'><joint type='hinge' axis='0 0 1'/>"
                      "<inertial pos='0.02 -0.03 0.05' mass='%g' diaginertia='0.03 0.02 0.015'/>",
                rows[i][0], -rows[i][1] * rows[i][2], rows[i][1] == 0 ? rows[i][2] : 0.0, cos(half), sin(half), 3.0 - 0.3 * i);
    }
    for (int i = 0; i < 7; i++) fprintf(file, "</body>");
    fprintf(file, "</worldbody></mujoco>");
    fclose(file);

    char error[1000] = "";
    mjModel *model = mj_loadXML(argv[1], NULL, error, sizeof error);
    if (!model) {
        fprintf(stderr, "%s\n", error);
        return 1;
    }
    mjData *data = mj_makeData(model);
    draw_samples();
    TIME("torque-rigid\tMuJoCo C", 2000, {
        memcpy(data->qpos, sample_q[k], sizeof sample_q[k]);
        memcpy(data->qvel, sample_dq[k], sizeof sample_dq[k]);
        memcpy(data->qacc, sample_ddq[k], sizeof sample_ddq[k]);
        mj_inverse(model, data);
    });
    fprintf(stderr, "%g\n", data->qfrc_inverse[3]);
    mj_deleteData(data);
    mj_deleteModel(model);
    return 0;
}

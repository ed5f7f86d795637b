/* The arm of Table 1 under an exported law, for a browser: motion.h has the reference, the tip force and the first state. */
#include "plant.h"
#include "laws.h"
#include "motion.h"

enum { PARTS = 6 }; /* reference: q_d, their first and second derivatives, two joints each */

static plant_state plant;
static int policy, step_number;
static double observation[10], held[6];
double shown[10]; /* link angles, motor angles, tip, reference of the tip, torques */

void *memset(void *to, int value, unsigned long size)
{
    unsigned char *at = to;
    while (size--) {
        *at++ = (unsigned char)value;
    }
    return to;
}

void *memcpy(void *to, const void *from, unsigned long size)
{
    unsigned char *at = to;
    const unsigned char *other = from;
    while (size--) {
        *at++ = *other++;
    }
    return to;
}

/* Clenshaw's recurrence: the sum of c[k] T_k(x). */
static double series(const double *c, double x)
{
    double b = 0.0, before = 0.0;
    for (int k = DEGREE; k > 0; k--) {
        const double now = c[k] + 2.0 * x * b - before;
        before = b;
        b = now;
    }
    return c[0] + x * b - before;
}

static void look(void)
{
    const double x = 2.0 * step_number / STEPS - 1.0;
    for (int k = 0; k < PARTS; k++) {
        observation[4 + k] = series(REFERENCE[k], x);
    }
    for (int k = 0; k < 2; k++) {
        observation[k] = plant.memory[k];
        observation[2 + k] = plant.memory[4 + k];
        shown[k] = plant.memory[2 + k];
        shown[2 + k] = plant.memory[k];
        shown[6 + k] = series(TIP[k], x);
    }
}

/* Begin an episode with a law and a payload at the tip [kg]. */
void start(int law, double payload)
{
    policy = law;
    step_number = 0;
    for (int k = 0; k < 8; k++) {
        plant.memory[k] = START[k];
    }
    plant.memory[8] = payload;
    law_init(policy);
    look();
    shown[4] = shown[6];
    shown[5] = shown[7];
}

/* Hold the torques of the law for 1 ms under a share of the machining force; return the tip error [m]. */
double step(double share)
{
    law_step(policy, observation, held);
    for (int k = 0; k < 4; k++) {
        held[2 + k] = share * (double)FORCE[step_number][k];
    }
    plant_step(&plant, held, shown + 4);
    step_number++;
    look();
    shown[8] = held[0];
    shown[9] = held[1];
    return __builtin_sqrt((shown[4] - shown[6]) * (shown[4] - shown[6]) + (shown[5] - shown[7]) * (shown[5] - shown[7]));
}

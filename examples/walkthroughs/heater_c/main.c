/* How to call heater: ten periods of the controller, from a state that stays where it is.
   Written by deadtime 0.1.0.

       cc -std=c99 heater.c main.c -o heater_example && ./heater_example */

#include <stdio.h>

#include "heater.h"

int main(void)
{
    static heater_controller controller; /* the only memory; no need to clear it */
    heater_real y[HEATER_OUTPUTS], u[HEATER_INPUTS];
    static const heater_real rest[HEATER_OUTPUTS] = HEATER_Y0;
    int k, i;

    if (heater_reset(&controller, 0, 0) != HEATER_OK) {
        return 1;
    }
    for (i = 0; i < HEATER_OUTPUTS; i++) {
        y[i] = rest[i] + (heater_real)1;
    }
    for (k = 0; k < 10; k++) {
        /* On a target: wait for the timer, read y and the mode, then: */
        heater_status status = heater_update(&controller, y, 0, 0, 0, 0, u);
        /* and give u to the actuator, whatever the status: it is the last good one. */
        printf("t = %.4g s, status %d, u =", k * HEATER_STEP, (int)status);
        for (i = 0; i < HEATER_INPUTS; i++) {
            printf(" %.6g", (double)u[i]);
        }
        printf("\n");
    }
    return 0;
}

/* How to call turntable: ten periods of the controller, from a state that stays where it is.
   Written by deadtime 0.1.0.

       cc -std=c99 turntable.c main.c -o turntable_example && ./turntable_example */

#include <stdio.h>

#include "turntable.h"

int main(void)
{
    static turntable_controller controller; /* the only memory; no need to clear it */
    turntable_real x[TURNTABLE_STATES], u[TURNTABLE_INPUTS];
    int k, i;

    if (turntable_reset(&controller, 0, 0) != TURNTABLE_OK) {
        return 1;
    }
    for (i = 0; i < TURNTABLE_STATES; i++) {
        x[i] = (turntable_real)1;
    }
    for (k = 0; k < 10; k++) {
        /* On a target: wait for the timer, read x and the mode, then: */
        turntable_status status = turntable_update(&controller, x, 0, 0, 0, u);
        /* and give u to the actuator, whatever the status: it is the last good one. */
        printf("t = %.4g s, status %d, u =", k * TURNTABLE_STEP, (int)status);
        for (i = 0; i < TURNTABLE_INPUTS; i++) {
            printf(" %.6g", (double)u[i]);
        }
        printf("\n");
    }
    return 0;
}

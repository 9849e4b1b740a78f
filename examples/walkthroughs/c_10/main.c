
#include <stdio.h>
#include "turntable.h"
int main(void)
{
    static turntable_controller c;
    float x[TURNTABLE_STATES], u[TURNTABLE_INPUTS];
    int mode;
    (void)turntable_reset(&c, 0, 0);
    while (scanf("%d %f %f", &mode, &x[0], &x[1]) == 3) {
        (void)turntable_update(&c, x, mode, 0, 0, u);
        printf("%.9g\n", (double)u[0]);
    }
    return 0;
}

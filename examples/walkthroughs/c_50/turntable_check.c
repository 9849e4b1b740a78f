/* Compares turntable with the vectors that deadtime's own controller made: turntable_vectors.csv.
   Written by deadtime 0.1.0. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "turntable.h"

#define TOLERANCE 2e-05 /* relative to the largest sum of |terms| */
#define SCALE 34.346140058546524

#define AMPLITUDE 0.5

/* The numbers that the vectors were made with, where a line stands for many calls. */
static turntable_real draw(void)
{
    static uint32_t seed = 1;
    seed = 1664525u * seed + 1013904223u;
    return (turntable_real)(AMPLITUDE * ((double)(seed >> 8) / 8388608.0 - 1.0));
}

/* So many calls, and the sum of the answers. */
static void fill(turntable_controller *controller, int skip, int32_t mode, double *sum)
{
    turntable_real x[TURNTABLE_STATES], applied[TURNTABLE_INPUTS], u[TURNTABLE_INPUTS];
    int i, k;
    for (k = 0; k < skip; k++) {
        for (i = 0; i < TURNTABLE_STATES; i++) {
            x[i] = draw();
        }
        for (i = 0; i < TURNTABLE_INPUTS; i++) {
            applied[i] = draw();
        }
        (void)turntable_update(controller, x, mode, applied, 0, u);
        for (i = 0; i < TURNTABLE_INPUTS; i++) {
            sum[i] += (double)u[i];
        }
    }
}

/* The next field of a line: 0 if it is empty. */
static int field(char **line, double *value)
{
    char *end = *line + strcspn(*line, ",\n\r");
    int given = end > *line;
    *value = given ? strtod(*line, 0) : 0.0;
    *line = *end == ',' ? end + 1 : end;
    return given;
}

static int one(char *line, turntable_controller *controller, double *worst, int *calls)
{
    turntable_real x[TURNTABLE_STATES], applied[TURNTABLE_INPUTS], u[TURNTABLE_INPUTS];
    double time, number, sum[TURNTABLE_INPUTS] = {0};
    int i, good = 1, given = 1, timed, skip;
    int32_t mode;
    (void)field(&line, &number);
    skip = (int)number;
    timed = field(&line, &time);
    (void)field(&line, &number);
    mode = (int32_t)number;
    for (i = 0; i < TURNTABLE_STATES; i++) {
        (void)field(&line, &number);
        x[i] = (turntable_real)number;
    }
    for (i = 0; i < TURNTABLE_INPUTS; i++) {
        given = field(&line, &number);
        applied[i] = (turntable_real)number;
    }
    fill(controller, skip, mode, sum);
    {
        turntable_status status = turntable_update(controller, x, mode, given ? applied : 0,
                                        timed ? &time : 0, u);
        (void)field(&line, &number);
        good = (int)status == (int)number;
        *calls += skip + 1;
    }
    for (i = 0; i < TURNTABLE_INPUTS; i++) {
        double error;
        (void)field(&line, &number);
        error = (number - (sum[i] + (double)u[i])) / (SCALE * (skip + 1));
        error = error < 0.0 ? -error : error;
        *worst = error > *worst ? error : *worst;
        good = good && error <= TOLERANCE;
    }
    return good;
}

int main(int argc, char **argv)
{
    static turntable_controller controller;
    static turntable_real past[TURNTABLE_TAPS * TURNTABLE_INPUTS];
    static char line[186];
    FILE *file = fopen(argc > 1 ? argv[1] : "turntable_vectors.csv", "r");
    double worst = 0.0;
    int count = 0, calls = 0, failed = 0, i;
    if (file == 0 || fgets(line, (int)sizeof line, file) == 0
        || fgets(line, (int)sizeof line, file) == 0) {
        printf("turntable_vectors.csv cannot be read\n");
        return 2;
    }
    for (i = 0; i < TURNTABLE_TAPS * TURNTABLE_INPUTS; i++) {
        past[i] = draw();
    }
    (void)turntable_reset(&controller, past, 7);
    while (fgets(line, (int)sizeof line, file) != 0) {
        count++;
        if (!one(line, &controller, &worst, &calls)) {
            failed++;
            printf("vector %d (line %d) differs\n", count, count + 2);
        }
    }
    (void)fclose(file);
    printf("%d vectors, %d differ, worst error %.1e of the largest sum of |terms| (allowed %.0e); "
           "%d calls, 1 of 1 rows, all 5 past inputs\n",
           count, failed, worst, TOLERANCE, calls);
    return failed > 0 || count == 0;
}

/* Compares heater with the vectors that deadtime's own controller made: heater_vectors.csv.
   Written by deadtime 0.1.0. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "heater.h"

#define TOLERANCE 1e-12 /* relative to the largest sum of |terms| */
#define SCALE 407.9541916243031

#define AMPLITUDE 1.0

/* The numbers that the vectors were made with, where a line stands for many calls. */
static heater_real draw(void)
{
    static uint32_t seed = 1;
    seed = 1664525u * seed + 1013904223u;
    return (heater_real)(AMPLITUDE * ((double)(seed >> 8) / 8388608.0 - 1.0));
}

static const heater_real rest[HEATER_OUTPUTS] = HEATER_Y0, rest_u[HEATER_INPUTS] = HEATER_U0;

/* So many calls, and the sum of the answers. */
static void fill(heater_controller *controller, int skip, int32_t mode, double *sum)
{
    heater_real y[HEATER_OUTPUTS], applied[HEATER_INPUTS], u[HEATER_INPUTS];
    int i, k;
    for (k = 0; k < skip; k++) {
        for (i = 0; i < HEATER_OUTPUTS; i++) {
            y[i] = rest[i] + draw();
        }
        for (i = 0; i < HEATER_INPUTS; i++) {
            applied[i] = rest_u[i] + draw();
        }
        (void)heater_update(controller, y, mode, applied, 0, 0, u);
        for (i = 0; i < HEATER_INPUTS; i++) {
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

static int one(char *line, heater_controller *controller, double *worst, int *calls)
{
    heater_real y[HEATER_OUTPUTS], applied[HEATER_INPUTS], u[HEATER_INPUTS];
    heater_real reference[HEATER_TRACKED];
    double time, number, sum[HEATER_INPUTS] = {0};
    int i, good = 1, given = 1, timed, skip, referred = 1;
    int32_t mode;
    (void)field(&line, &number);
    skip = (int)number;
    timed = field(&line, &time);
    (void)field(&line, &number);
    mode = (int32_t)number;
    for (i = 0; i < HEATER_OUTPUTS; i++) {
        (void)field(&line, &number);
        y[i] = (heater_real)number;
    }
    for (i = 0; i < HEATER_TRACKED; i++) {
        referred = field(&line, &number);
        reference[i] = (heater_real)number;
    }
    for (i = 0; i < HEATER_INPUTS; i++) {
        given = field(&line, &number);
        applied[i] = (heater_real)number;
    }
    fill(controller, skip, mode, sum);
    {
        heater_status status = heater_update(controller, y, mode, given ? applied : 0,
                                        referred ? reference : 0, timed ? &time : 0, u);
        (void)field(&line, &number);
        good = (int)status == (int)number;
        *calls += skip + 1;
    }
    for (i = 0; i < HEATER_INPUTS; i++) {
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
    static heater_controller controller;
    static heater_real past[HEATER_TAPS * HEATER_INPUTS];
    static char line[180];
    FILE *file = fopen(argc > 1 ? argv[1] : "heater_vectors.csv", "r");
    double worst = 0.0;
    int count = 0, calls = 0, failed = 0, i;
    if (file == 0 || fgets(line, (int)sizeof line, file) == 0
        || fgets(line, (int)sizeof line, file) == 0) {
        printf("heater_vectors.csv cannot be read\n");
        return 2;
    }
    for (i = 0; i < HEATER_TAPS * HEATER_INPUTS; i++) {
        past[i] = rest_u[i % HEATER_INPUTS] + draw();
    }
    (void)heater_reset(&controller, past, 7);
    while (fgets(line, (int)sizeof line, file) != 0) {
        count++;
        if (!one(line, &controller, &worst, &calls)) {
            failed++;
            printf("vector %d (line %d) differs\n", count, count + 2);
        }
    }
    (void)fclose(file);
    printf("%d vectors, %d differ, worst error %.1e of the largest sum of |terms| (allowed %.0e); "
           "%d calls, 295 of 302 rows, all 30 past inputs\n",
           count, failed, worst, TOLERANCE, calls);
    return failed > 0 || count == 0;
}

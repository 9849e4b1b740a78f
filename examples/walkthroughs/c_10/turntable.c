/* Controller of the law "averaged": see turntable.h. Written by deadtime 0.1.0. */

#include "turntable.h"
#include "turntable_tables.h"

#if defined(__FAST_MATH__) || defined(_M_FP_FAST) \
    || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "-ffast-math, -ffinite-math-only and /fp:fast take the checks for NaN away: compile this file without it"
#endif

enum { TURNTABLE_LENGTH = TURNTABLE_TAPS * TURNTABLE_INPUTS };

#define TURNTABLE_MOST_PERIODS 100000.0 /* that a call may be ahead of the last one */
#define TURNTABLE_MOST_TIME 1e17        /* s; a time beyond it is none */
#define TURNTABLE_MOST_SAMPLES 9e15     /* a double counts so far */

/* The value within the bound: cut to it, 0 for a NaN, and said so. */
static turntable_real turntable_cut(turntable_real value, turntable_real bound, int32_t *cuts)
{
    if (value != value || value < -bound || value > bound) {
        *cuts = 1;
        return value > bound ? bound : value < -bound ? -bound : 0;
    }
    return value;
}

static int32_t turntable_all_usable(const turntable_real *values, int32_t count, turntable_real bound)
{
    int32_t i;
    for (i = 0; i < count; i++) {
        if (!(values[i] >= -bound && values[i] <= bound)) { /* nor is a NaN */
            return 0;
        }
    }
    return 1;
}

static void turntable_clear(turntable_controller *c)
{
    int32_t i;
    c->place = 0;
    for (i = 0; i < 2 * TURNTABLE_LENGTH; i++) {
        c->ring[i] = 0;
    }
}

/* u becomes the latest input: from place * INPUTS on, the ring holds the last N in a row. */
static void turntable_push(turntable_controller *c, const turntable_real *u, int32_t *clamped)
{
    int32_t i;
    (void)clamped; /* there are no sums that could leave their bounds */
    /*@ loop unroll TURNTABLE_INPUTS; */
    for (i = 0; i < TURNTABLE_INPUTS; i++) {
        c->ring[c->place * TURNTABLE_INPUTS + i] = u[i];
        c->ring[TURNTABLE_LENGTH + c->place * TURNTABLE_INPUTS + i] = u[i];
    }
    c->place = c->place + 1 < TURNTABLE_TAPS ? c->place + 1 : 0;
}

/* Four sums, which a processor can add side by side. */
static turntable_real turntable_dot(const turntable_real *a, const turntable_real *b)
{
    turntable_real s0 = 0, s1 = 0, s2 = 0, s3 = 0;
    int32_t i;
    /*@ loop unroll TURNTABLE_LENGTH; */
    for (i = 0; i + 3 < TURNTABLE_LENGTH; i += 4) {
        s0 += a[i] * b[i];
        s1 += a[i + 1] * b[i + 1];
        s2 += a[i + 2] * b[i + 2];
        s3 += a[i + 3] * b[i + 3];
    }
    /*@ loop unroll 4; */
    for (i = TURNTABLE_LENGTH - TURNTABLE_LENGTH % 4; i < TURNTABLE_LENGTH; i++) {
        s0 += a[i] * b[i];
    }
    return (s0 + s1) + (s2 + s3);
}

/* asked = F x + G past. */
static void turntable_apply_rows(const turntable_controller *c, int32_t row, const turntable_real *x, turntable_real *asked)
{
    const turntable_real *past = c->ring + c->place * TURNTABLE_INPUTS;
    int32_t i, j;
    /*@ loop unroll TURNTABLE_INPUTS; */
    for (i = 0; i < TURNTABLE_INPUTS; i++) {
        turntable_real sum = turntable_dot(turntable_G[row][i], past);
        /*@ loop unroll TURNTABLE_STATES; */
        for (j = 0; j < TURNTABLE_STATES; j++) {
            sum += turntable_F[row][i][j] * x[j];
        }
        asked[i] = sum;
    }
}

static int32_t turntable_past_usable(const turntable_controller *c)
{
    return turntable_all_usable(c->ring, 2 * TURNTABLE_LENGTH, TURNTABLE_BOUND);
}

/* Whether every integer is one that this file can have left. */
static int32_t turntable_in_order(const turntable_controller *c)
{
    return c->ready == TURNTABLE_READY && c->place >= 0 && c->place < TURNTABLE_TAPS && c->mode >= -1
           && c->mode < TURNTABLE_MODES && c->age >= 0 && c->age <= TURNTABLE_AGES
           && (c->timed == 0 || c->timed == 1);
}

/* An input within the limits. */
static turntable_real turntable_limited(turntable_real u, int32_t i)
{
    return u < turntable_LOW[i] ? turntable_LOW[i] : u > turntable_HIGH[i] ? turntable_HIGH[i] : u;
}

/* The input in force is a number whatever became of the memory. */
static void turntable_mend_held(turntable_controller *c, int32_t *clamped)
{
    int32_t i;
    /*@ loop unroll TURNTABLE_INPUTS; */
    for (i = 0; i < TURNTABLE_INPUTS; i++) {
        c->held[i] = turntable_cut(c->held[i], TURNTABLE_BOUND, clamped);
    }
}

/* From the first call on the input is within the limits, whatever it was before. */
static void turntable_limit_held(turntable_controller *c)
{
    int32_t i;
    /*@ loop unroll TURNTABLE_INPUTS; */
    for (i = 0; i < TURNTABLE_INPUTS; i++) {
        c->held[i] = turntable_limited(c->held[i], i);
    }
}

/* Periods that have begun since the last call; 0: none, the call is out of order. */
static int32_t turntable_elapsed(turntable_controller *c, const double *time)
{
    int32_t periods = 1;
    if (time != 0) {
        double now = *time;
        if (now != now || now < -TURNTABLE_MOST_TIME || now > TURNTABLE_MOST_TIME) {
            return 0;
        }
        if (c->timed == 0) {
            /* As if the calls without a time had come on time. */
            double origin = now - (c->last + 1.0) * TURNTABLE_STEP;
            if (!(origin >= -1e18 && origin <= 1e18)) {
                return 0;
            }
            c->origin = origin;
            c->timed = 1;
        } else {
            double ahead = (now - c->origin) / TURNTABLE_STEP - c->last;
            if (!(ahead >= 0.5 && ahead <= TURNTABLE_MOST_PERIODS)) {
                return 0;
            }
            periods = (int32_t)(ahead + 0.5);
        }
    }
    c->last += (double)periods;
    if (c->last > TURNTABLE_MOST_SAMPLES) {
        c->last = TURNTABLE_MOST_SAMPLES;
    }
    return periods;
}

/* The input of the period that ends becomes the latest of the past ones. */
static turntable_status turntable_remember(turntable_controller *c, const turntable_real *applied, int32_t *clamped)
{
    turntable_real u[TURNTABLE_INPUTS];
    int32_t i, bad = 0;
    /*@ loop unroll TURNTABLE_INPUTS; */
    for (i = 0; i < TURNTABLE_INPUTS; i++) {
        u[i] = applied == 0 ? c->held[i] : turntable_cut(applied[i], TURNTABLE_BOUND, &bad);
    }
    turntable_push(c, bad ? c->held : u, clamped);
    return bad ? TURNTABLE_BAD_APPLIED : TURNTABLE_OK;
}

/* u within the limits, or the last one where it is not finite. */
static turntable_status turntable_compute(turntable_controller *c, const turntable_real *x)
{
    turntable_real asked[TURNTABLE_INPUTS];
    int32_t i, row = 0, beyond = 0;
    turntable_status status = TURNTABLE_OK;
    turntable_apply_rows(c, row, x, asked);
    /*@ loop unroll TURNTABLE_INPUTS; */
    for (i = 0; i < TURNTABLE_INPUTS; i++) {
        asked[i] = turntable_cut(asked[i], TURNTABLE_BOUND, &beyond);
    }
    if (beyond) {
        return turntable_past_usable(c) ? TURNTABLE_OVERFLOW : TURNTABLE_CLAMPED;
    }
    /*@ loop unroll TURNTABLE_INPUTS; */
    for (i = 0; i < TURNTABLE_INPUTS; i++) {
        c->held[i] = turntable_limited(asked[i], i);
        if (c->held[i] < asked[i] || c->held[i] > asked[i]) {
            status = TURNTABLE_SATURATED;
        }
    }
    return status;
}

static turntable_status turntable_judge(turntable_controller *c, const turntable_real *x)
{
    turntable_real seen[TURNTABLE_STATES];
    int32_t i, large = 0, infinite = 0;
    /*@ loop unroll TURNTABLE_STATES; */
    for (i = 0; i < TURNTABLE_STATES; i++) {
        seen[i] = turntable_cut(turntable_cut(x[i], 3.4028235e+38f, &infinite), TURNTABLE_BOUND, &large);
    }
    if (infinite) {
        return TURNTABLE_BAD_STATE;
    }
    return large ? TURNTABLE_OVERFLOW : turntable_compute(c, seen);
}

turntable_status turntable_update(turntable_controller *c, const turntable_real *x, int32_t mode, const turntable_real *applied,
                       const double *time, turntable_real *u)
{
    int32_t i, periods, clamped = 0;
    turntable_status status;
    if (u == 0) {
        return TURNTABLE_NOT_READY;
    }
    if (c == 0 || x == 0 || !turntable_in_order(c)) {
        for (i = 0; i < TURNTABLE_INPUTS; i++) {
            u[i] = turntable_limited(0, i);
        }
        return TURNTABLE_NOT_READY;
    }
    turntable_mend_held(c, &clamped);
    periods = turntable_elapsed(c, time);
    if (periods == 0) {
        status = clamped != 0 ? TURNTABLE_CLAMPED : TURNTABLE_OUT_OF_ORDER;
        c->refused++;
    } else {
        int32_t missed = periods - 1;
        /* A window holds no more than N: beyond that nothing changes. */
        for (i = 0; i < missed && i < TURNTABLE_TAPS; i++) {
            (void)turntable_remember(c, applied, &clamped);
        }
        status = turntable_remember(c, applied, &clamped);
        turntable_limit_held(c);
        (void)mode; /* one row serves every mode */
        if (clamped != 0) {
            status = TURNTABLE_CLAMPED;
        }
        if (status == TURNTABLE_OK) {
            status = turntable_judge(c, x);
        }
        if (status > TURNTABLE_SATURATED) {
            c->refused++;
        }
        c->late += (uint64_t)missed;
        c->samples += (uint64_t)periods;
        if (missed > 0 && status <= TURNTABLE_SATURATED) {
            status = TURNTABLE_LATE;
        }
    }
    /*@ loop unroll TURNTABLE_INPUTS; */
    for (i = 0; i < TURNTABLE_INPUTS; i++) {
        u[i] = turntable_limited(c->held[i], i);
    }
    return status;
}

turntable_status turntable_reset(turntable_controller *c, const turntable_real *u0, int32_t mode_age)
{
    int32_t i, j, clamped = 0, good = u0 != 0;
    if (c == 0) {
        return TURNTABLE_NOT_READY;
    }
    if (good) {
        good = turntable_all_usable(u0, TURNTABLE_TAPS * TURNTABLE_INPUTS, TURNTABLE_BOUND);
    }
    c->ready = TURNTABLE_READY;
    c->mode = -1;
    c->age = mode_age < 0 ? 0 : mode_age > TURNTABLE_AGES ? TURNTABLE_AGES : mode_age;
    c->timed = 0;
    c->origin = 0.0;
    c->last = -1.0;
    c->samples = c->refused = c->late = 0;
    turntable_clear(c);
    for (i = 0; i < TURNTABLE_TAPS; i++) {
        for (j = 0; j < TURNTABLE_INPUTS; j++) {
            c->held[j] = good ? u0[i * TURNTABLE_INPUTS + j] : 0;
        }
        if (i < TURNTABLE_TAPS - 1) {
            turntable_push(c, c->held, &clamped); /* the last one is pushed by the first call */
        }
    }
    return good || u0 == 0 ? TURNTABLE_OK : TURNTABLE_BAD_APPLIED;
}

turntable_status turntable_restore(turntable_controller *c, const turntable_controller *kept)
{
    if (c == 0 || kept == 0 || !turntable_in_order(kept) || !turntable_past_usable(kept)
        || !turntable_all_usable(kept->held, TURNTABLE_INPUTS, TURNTABLE_BOUND)
        || !(kept->origin >= -1e18 && kept->origin <= 1e18)
        || !(kept->last >= -1.0 && kept->last <= TURNTABLE_MOST_SAMPLES)) {
        return TURNTABLE_NOT_READY;
    }
    *c = *kept;
    return TURNTABLE_OK;
}

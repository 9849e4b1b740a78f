/* Controller of the law "expected, observed": see heater.h. Written by deadtime 0.1.0. */

#include "heater.h"
#include "heater_tables.h"

#if defined(__FAST_MATH__) || defined(_M_FP_FAST) \
    || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "-ffast-math, -ffinite-math-only and /fp:fast take the checks for NaN away: compile this file without it"
#endif

enum { HEATER_LENGTH = HEATER_TAPS * HEATER_INPUTS };

#define HEATER_MOST_PERIODS 100000.0 /* that a call may be ahead of the last one */
#define HEATER_MOST_TIME 1e17        /* s; a time beyond it is none */
#define HEATER_MOST_SAMPLES 9e15     /* a double counts so far */

/* The value within the bound: cut to it, 0 for a NaN, and said so. */
static heater_real heater_cut(heater_real value, heater_real bound, int32_t *cuts)
{
    if (value != value || value < -bound || value > bound) {
        *cuts = 1;
        return value > bound ? bound : value < -bound ? -bound : 0;
    }
    return value;
}

static int32_t heater_all_usable(const heater_real *values, int32_t count, heater_real bound)
{
    int32_t i;
    for (i = 0; i < count; i++) {
        if (!(values[i] >= -bound && values[i] <= bound)) { /* nor is a NaN */
            return 0;
        }
    }
    return 1;
}

/* What the law is given, z: the estimate, the sums of the tracking errors and the reference, operation
   by operation as in deadtime's Controller. No number leaves +-HEATER_BOUND: where one is cut, the
   last input is held, and the estimate begins anew. */

enum {
    HEATER_LAGS = 4
};

/* Over a period inputs of so many periods before act. */
static const int32_t heater_LAG[HEATER_LAGS] = { 30, 29, 16, 15 };

/* u, as applied, becomes the latest input that the observer knows of. */
static void heater_note(heater_controller *c, const heater_real *u)
{
    int32_t i;
    /*@ loop unroll HEATER_INPUTS; */
    for (i = 0; i < HEATER_INPUTS; i++) {
        c->sent[c->next][i] = u[i];
    }
    c->next = c->next + 1 < HEATER_SENT ? c->next + 1 : 0;
}

/* The mode that the observer predicts with: the last known, mode 0 before there was one. */
static int32_t heater_believed(const heater_controller *c)
{
    return c->mode > 0 ? c->mode : 0;
}

/* The estimate goes over the period that ended, in the mode of its start; there is none at sample 0. */
static void heater_foresee(heater_controller *c, int32_t *beyond)
{
    int32_t late, a, b, row, mode = heater_believed(c);
    heater_real next[HEATER_ESTIMATES];
    if (c->samples == 0) {
        return;
    }
    /*@ loop unroll HEATER_ESTIMATES; */
    for (a = 0; a < HEATER_ESTIMATES; a++) {
        heater_real sum = 0;
        /*@ loop unroll HEATER_ESTIMATES; */
        for (b = 0; b < HEATER_ESTIMATES; b++) {
            sum += heater_PREDICT_X[mode][a][b] * c->z[b];
        }
        /*@ loop unroll HEATER_LAGS; */
        for (late = 0; late < HEATER_LAGS; late++) {
            row = c->next - 1 - heater_LAG[late];
            row = row < 0 ? row + HEATER_SENT : row;
            /*@ loop unroll HEATER_INPUTS; */
            for (b = 0; b < HEATER_INPUTS; b++) {
                sum += heater_PREDICT_U[mode][late][a][b] * c->sent[row][b];
            }
        }
        next[a] = heater_cut(sum, HEATER_BOUND, beyond);
    }
    /*@ loop unroll HEATER_ESTIMATES; */
    for (a = 0; a < HEATER_ESTIMATES; a++) {
        c->z[a] = next[a];
    }
}

/* x += L (y - C x), if y is finite; whether it is. */
static int32_t heater_correct(heater_controller *c, const heater_real *y, int32_t *beyond)
{
    heater_real apart[HEATER_OUTPUTS];
    int32_t i, j, lost = 0, mode = heater_believed(c);
    /*@ loop unroll HEATER_OUTPUTS; */
    for (i = 0; i < HEATER_OUTPUTS; i++) {
        apart[i] = heater_cut(y[i], HEATER_BOUND, &lost);
        /*@ loop unroll HEATER_ESTIMATES; */
        for (j = 0; j < HEATER_ESTIMATES; j++) {
            apart[i] -= heater_MEASURE[mode][i][j] * c->z[j];
        }
    }
    if (lost != 0) {
        return 0;
    }
    /*@ loop unroll HEATER_ESTIMATES; */
    for (i = 0; i < HEATER_ESTIMATES; i++) {
        heater_real sum = c->z[i];
        /*@ loop unroll HEATER_OUTPUTS; */
        for (j = 0; j < HEATER_OUTPUTS; j++) {
            sum += heater_CORRECT[mode][i][j] * apart[j];
        }
        c->z[i] = heater_cut(sum, HEATER_BOUND, beyond);
    }
    return 1;
}

/* The tracked outputs as measured; y == 0: of the estimate. */
static void heater_measure(const heater_controller *c, const heater_real *y, heater_real *now, int32_t *beyond)
{
    int32_t i, j, k, mode = heater_believed(c);
    /*@ loop unroll HEATER_TRACKED; */
    for (i = 0; i < HEATER_TRACKED; i++) {
        heater_real sum = 0;
        /*@ loop unroll HEATER_OUTPUTS; */
        for (j = 0; j < HEATER_OUTPUTS; j++) {
            heater_real output = 0;
            if (y != 0) {
                output = heater_cut(y[j], HEATER_BOUND, beyond);
            } else {
                /*@ loop unroll HEATER_ESTIMATES; */
                for (k = 0; k < HEATER_ESTIMATES; k++) {
                    output += heater_MEASURE[mode][j][k] * c->z[k];
                }
            }
            sum += heater_TRACK[i][j] * output;
        }
        now[i] = heater_cut(sum, HEATER_BOUND, beyond);
    }
}

#define HEATER_PERIOD ((heater_real)HEATER_STEP)
#define HEATER_ROUND_OFF ((heater_real)1e-09) /* of what was asked for: less was not refused */

static heater_real heater_magnitude(heater_real value)
{
    return value < 0 ? -value : value;
}

/* q += h ((before + now) / 2 - r), unless that asks for more of what an input was refused. */
static void heater_integrate(heater_controller *c, const heater_real *now, int32_t *beyond)
{
    const heater_real *applied = c->sent[c->next > 0 ? c->next - 1 : HEATER_SENT - 1];
    const heater_real *r = c->z + HEATER_ESTIMATES + HEATER_SUMS;
    heater_real further = 0;
    int32_t i, j, mode = heater_believed(c);
    /*@ loop unroll HEATER_INPUTS; */
    for (i = 0; i < HEATER_INPUTS; i++) {
        heater_real change = 0, refused = c->asked[i] - applied[i];
        /*@ loop unroll HEATER_SUMS; */
        for (j = 0; j < HEATER_SUMS; j++) {
            change += heater_ANSWER[mode][i][j] * HEATER_PERIOD * ((heater_real)0.5 * (c->before[j] + now[j]) - r[j]);
        }
        if (heater_magnitude(refused) > HEATER_ROUND_OFF * heater_magnitude(c->asked[i])) {
            further += refused * change;
        }
    }
    if (further > 0) {
        return;
    }
    /*@ loop unroll HEATER_SUMS; */
    for (j = 0; j < HEATER_SUMS; j++) {
        heater_real q = c->z[HEATER_ESTIMATES + j] + HEATER_PERIOD * ((heater_real)0.5 * (c->before[j] + now[j]) - r[j]);
        c->z[HEATER_ESTIMATES + j] = heater_cut(q, HEATER_BOUND, beyond);
    }
}

/* The reference of this sample: as given, 0: the law's own; where it is not finite the last goes on,
   and is said to. */
static void heater_refer(heater_controller *c, const heater_real *given, int32_t *astray)
{
    heater_real r[HEATER_TRACKED];
    int32_t i, low = 0;
    /*@ loop unroll HEATER_TRACKED; */
    for (i = 0; i < HEATER_TRACKED; i++) {
        r[i] = given == 0 ? heater_REFERENCE[low][i] : heater_cut(given[i], HEATER_BOUND, astray);
    }
    /*@ loop unroll HEATER_TRACKED; */
    for (i = 0; i < HEATER_TRACKED; i++) {
        c->z[HEATER_STATES - HEATER_TRACKED + i] = *astray == 0 ? r[i] : c->z[HEATER_STATES - HEATER_TRACKED + i];
    }
}

/* z at this sample, after `foresee`; y == 0: there is none. Whether it corrected anything. */
static int32_t heater_observe(heater_controller *c, const heater_real *y, int32_t *beyond,
                       const heater_real *reference, int32_t *astray)
{
    int32_t i, use = 0;
    heater_real now[HEATER_TRACKED];
    if (y != 0) {
        use = heater_correct(c, y, beyond);
    }
    heater_measure(c, use != 0 ? y : 0, now, beyond);
    if (c->samples > 0) {
        heater_integrate(c, now, beyond);
    }
    /*@ loop unroll HEATER_TRACKED; */
    for (i = 0; i < HEATER_TRACKED; i++) {
        c->before[i] = now[i];
    }
    heater_refer(c, reference, astray);
    return use;
}

/* The law had no answer: what is in force counts as asked for. */
static void heater_ask_held(heater_controller *c)
{
    int32_t i;
    /*@ loop unroll HEATER_INPUTS; */
    for (i = 0; i < HEATER_INPUTS; i++) {
        c->asked[i] = c->held[i];
    }
}

/* A period without a call: the observer predicts. */
static void heater_miss(heater_controller *c, int32_t *beyond)
{
    int32_t astray = 0;
    heater_foresee(c, beyond);
    (void)heater_observe(c, 0, beyond, 0, &astray);
    heater_ask_held(c);
    c->samples++;
}

/* z as before the first call. */
static void heater_begin_anew(heater_controller *c)
{
    int32_t i;
    /*@ loop unroll HEATER_STATES; */
    for (i = 0; i < HEATER_STATES; i++) {
        c->z[i] = heater_BEGIN[i];
    }
}

/* All as before the first call; inputs before are noted afterwards. */
static void heater_begin_observer(heater_controller *c)
{
    int32_t i, j;
    heater_begin_anew(c);
    for (i = 0; i < HEATER_TRACKED; i++) {
        c->before[i] = 0;
    }
    c->next = 0;
    for (i = 0; i < HEATER_SENT; i++) {
        for (j = 0; j < HEATER_INPUTS; j++) {
            c->sent[i][j] = 0;
        }
    }
}

/* Cut what only damaged memory can have left beyond the bound. */
static void heater_mend_observer(heater_controller *c, int32_t *clamped)
{
    int32_t i;
    /*@ loop unroll HEATER_STATES; */
    for (i = 0; i < HEATER_STATES; i++) {
        c->z[i] = heater_cut(c->z[i], HEATER_BOUND, clamped);
    }
    /*@ loop unroll HEATER_TRACKED; */
    for (i = 0; i < HEATER_TRACKED; i++) {
        c->before[i] = heater_cut(c->before[i], HEATER_BOUND, clamped);
    }
    /*@ loop unroll HEATER_INPUTS; */
    for (i = 0; i < HEATER_INPUTS; i++) {
        c->asked[i] = heater_cut(c->asked[i], HEATER_BOUND, clamped);
    }
}

static int32_t heater_sent_usable(const heater_controller *c)
{
    return heater_all_usable(&c->sent[0][0], HEATER_SENT * HEATER_INPUTS, HEATER_BOUND);
}

static int32_t heater_observer_usable(const heater_controller *c)
{
    return heater_sent_usable(c) && heater_all_usable(c->z, HEATER_STATES, HEATER_BOUND)
           && heater_all_usable(c->before, HEATER_TRACKED, HEATER_BOUND)
           && heater_all_usable(c->asked, HEATER_INPUTS, HEATER_BOUND);
}

static void heater_clear(heater_controller *c)
{
    int32_t i;
    c->place = 0;
    for (i = 0; i < 2 * HEATER_LENGTH; i++) {
        c->ring[i] = 0;
    }
}

/* u becomes the latest input: from place * INPUTS on, the ring holds the last N in a row. */
static void heater_push(heater_controller *c, const heater_real *u, int32_t *clamped)
{
    int32_t i;
    (void)clamped; /* there are no sums that could leave their bounds */
    /*@ loop unroll HEATER_INPUTS; */
    for (i = 0; i < HEATER_INPUTS; i++) {
        c->ring[c->place * HEATER_INPUTS + i] = u[i];
        c->ring[HEATER_LENGTH + c->place * HEATER_INPUTS + i] = u[i];
    }
    c->place = c->place + 1 < HEATER_TAPS ? c->place + 1 : 0;
}

/* Four sums, which a processor can add side by side. */
static heater_real heater_dot(const heater_real *a, const heater_real *b)
{
    heater_real s0 = 0, s1 = 0, s2 = 0, s3 = 0;
    int32_t i;
    /*@ loop unroll HEATER_LENGTH; */
    for (i = 0; i + 3 < HEATER_LENGTH; i += 4) {
        s0 += a[i] * b[i];
        s1 += a[i + 1] * b[i + 1];
        s2 += a[i + 2] * b[i + 2];
        s3 += a[i + 3] * b[i + 3];
    }
    /*@ loop unroll 4; */
    for (i = HEATER_LENGTH - HEATER_LENGTH % 4; i < HEATER_LENGTH; i++) {
        s0 += a[i] * b[i];
    }
    return (s0 + s1) + (s2 + s3);
}

/* asked = F x + G past. */
static void heater_apply_rows(const heater_controller *c, int32_t row, const heater_real *x, heater_real *asked)
{
    const heater_real *past = c->ring + c->place * HEATER_INPUTS;
    int32_t i, j;
    /*@ loop unroll HEATER_INPUTS; */
    for (i = 0; i < HEATER_INPUTS; i++) {
        heater_real sum = heater_dot(heater_G[row][i], past);
        /*@ loop unroll HEATER_STATES; */
        for (j = 0; j < HEATER_STATES; j++) {
            sum += heater_F[row][i][j] * x[j];
        }
        asked[i] = sum;
    }
}

static int32_t heater_past_usable(const heater_controller *c)
{
    return heater_all_usable(c->ring, 2 * HEATER_LENGTH, HEATER_BOUND);
}

/* Whether every integer is one that this file can have left. */
static int32_t heater_in_order(const heater_controller *c)
{
    return c->ready == HEATER_READY && c->place >= 0 && c->place < HEATER_TAPS && c->mode >= -1
           && c->mode < HEATER_MODES && c->age >= 0 && c->age <= HEATER_AGES
           && c->next >= 0 && c->next < HEATER_SENT
           && (c->timed == 0 || c->timed == 1);
}

/* An input within the limits. */
static heater_real heater_limited(heater_real u, int32_t i)
{
    return u < heater_LOW[i] ? heater_LOW[i] : u > heater_HIGH[i] ? heater_HIGH[i] : u;
}

/* The input in force is a number, and the estimate one, whatever became of the memory. */
static void heater_mend_held(heater_controller *c, int32_t *clamped)
{
    int32_t i;
    heater_mend_observer(c, clamped);
    /*@ loop unroll HEATER_INPUTS; */
    for (i = 0; i < HEATER_INPUTS; i++) {
        c->held[i] = heater_cut(c->held[i], HEATER_BOUND, clamped);
    }
}

/* From the first call on the input is within the limits, whatever it was before. */
static void heater_limit_held(heater_controller *c)
{
    int32_t i;
    /*@ loop unroll HEATER_INPUTS; */
    for (i = 0; i < HEATER_INPUTS; i++) {
        c->held[i] = heater_limited(c->held[i], i);
    }
}

/* Periods that have begun since the last call; 0: none, the call is out of order. */
static int32_t heater_elapsed(heater_controller *c, const double *time)
{
    int32_t periods = 1;
    if (time != 0) {
        double now = *time;
        if (now != now || now < -HEATER_MOST_TIME || now > HEATER_MOST_TIME) {
            return 0;
        }
        if (c->timed == 0) {
            /* As if the calls without a time had come on time. */
            double origin = now - (c->last + 1.0) * HEATER_STEP;
            if (!(origin >= -1e18 && origin <= 1e18)) {
                return 0;
            }
            c->origin = origin;
            c->timed = 1;
        } else {
            double ahead = (now - c->origin) / HEATER_STEP - c->last;
            if (!(ahead >= 0.5 && ahead <= HEATER_MOST_PERIODS)) {
                return 0;
            }
            periods = (int32_t)(ahead + 0.5);
        }
    }
    c->last += (double)periods;
    if (c->last > HEATER_MOST_SAMPLES) {
        c->last = HEATER_MOST_SAMPLES;
    }
    return periods;
}

/* The input of the period that ends becomes the latest of the past ones. */
static heater_status heater_remember(heater_controller *c, const heater_real *applied, int32_t *clamped)
{
    heater_real u[HEATER_INPUTS];
    int32_t i, bad = 0;
    /*@ loop unroll HEATER_INPUTS; */
    for (i = 0; i < HEATER_INPUTS; i++) {
        u[i] = applied == 0 ? c->held[i]
                            : heater_cut(heater_cut(applied[i], HEATER_BOUND, &bad) - heater_REST_U[i], HEATER_BOUND, &bad);
    }
    heater_push(c, bad ? c->held : u, clamped);
    heater_note(c, bad ? c->held : u);
    return bad ? HEATER_BAD_APPLIED : HEATER_OK;
}

static void heater_grow_older(heater_controller *c, int32_t periods)
{
    int32_t age = c->age + (periods < HEATER_AGES ? periods : HEATER_AGES);
    c->age = age < HEATER_AGES ? age : HEATER_AGES;
}

/* Follow the sampled mode and its age. */
static heater_status heater_see(heater_controller *c, int32_t mode)
{
    int32_t known = mode >= 0 && mode < HEATER_MODES;
    if (!known || mode == c->mode) {
        heater_grow_older(c, 1);
    } else if (c->mode >= 0) {
        c->age = 0;
    }
    if (!known) {
        return HEATER_BAD_MODE;
    }
    c->mode = mode;
    return HEATER_OK;
}

/* u within the limits, or the last one where it is not finite. */
static heater_status heater_compute(heater_controller *c, const heater_real *x)
{
    heater_real asked[HEATER_INPUTS];
    int32_t i, row = 0, beyond = 0;
    heater_status status = HEATER_OK;
    row = c->mode > 0 ? c->mode : 0; /* it is never less: `see` has been content */
    row = row * HEATER_AGES + (c->age < HEATER_AGES ? c->age : HEATER_AGES - 1);
    heater_apply_rows(c, row, x, asked);
    /*@ loop unroll HEATER_INPUTS; */
    for (i = 0; i < HEATER_INPUTS; i++) {
        asked[i] = heater_cut(asked[i], HEATER_BOUND, &beyond);
    }
    if (beyond) {
        return heater_past_usable(c) ? HEATER_OVERFLOW : HEATER_CLAMPED;
    }
    /*@ loop unroll HEATER_INPUTS; */
    for (i = 0; i < HEATER_INPUTS; i++) {
        c->held[i] = heater_limited(asked[i], i);
        if (c->held[i] < asked[i] || c->held[i] > asked[i]) {
            status = HEATER_SATURATED;
        }
        c->asked[i] = asked[i];
    }
    return status;
}

/* u of what the observer makes of y, or the last one. What was missing is said where there is one. */
static heater_status heater_answer(heater_controller *c, heater_status status, int32_t beyond,
                              heater_status missing)
{
    if (status == HEATER_OK) {
        if (beyond != 0) {
            status = heater_sent_usable(c) ? HEATER_OVERFLOW : HEATER_CLAMPED;
            heater_begin_anew(c);
        } else {
            status = heater_compute(c, c->z);
        }
        if (status <= HEATER_SATURATED) {
            return missing != HEATER_OK ? missing : status;
        }
    }
    heater_ask_held(c);
    return status;
}

/* Deviations from rest; what is refused stays what it is. */
static void heater_deviations(const heater_real *values, const heater_real *rest, int32_t count, heater_real *found)
{
    int32_t i;
    /*@ loop unroll 994; */
    for (i = 0; i < count; i++) {
        found[i] = values[i] >= -HEATER_BOUND && values[i] <= HEATER_BOUND ? values[i] - rest[i] : values[i];
    }
}

/* The input in force, as the actuator takes it. */
static heater_real heater_sent(heater_real u, int32_t i)
{
    int32_t beyond = 0;
    return heater_cut(heater_limited(u, i) + heater_REST_U[i], HEATER_BOUND, &beyond);
}

heater_status heater_update(heater_controller *c, const heater_real *y, int32_t mode, const heater_real *applied,
                       const heater_real *reference, const double *time, heater_real *u)
{
    int32_t i, periods, clamped = 0;
    heater_status status;
    heater_real deviation[HEATER_OUTPUTS], followed[HEATER_TRACKED];
    if (u == 0) {
        return HEATER_NOT_READY;
    }
    if (c == 0 || y == 0 || !heater_in_order(c)) {
        for (i = 0; i < HEATER_INPUTS; i++) {
            u[i] = heater_sent(0, i);
        }
        return HEATER_NOT_READY;
    }
    heater_deviations(y, heater_REST, HEATER_OUTPUTS, deviation);
    if (reference != 0) {
        heater_deviations(reference, heater_REST_R, HEATER_TRACKED, followed);
    }
    heater_mend_held(c, &clamped);
    periods = heater_elapsed(c, time);
    if (periods == 0) {
        status = clamped != 0 ? HEATER_CLAMPED : HEATER_OUT_OF_ORDER;
        c->refused++;
    } else {
        int32_t missed = periods - 1;
        int32_t astray = 0, beyond = 0;
        heater_status missing = HEATER_OK;
        for (i = 0; i < missed; i++) { /* the observer predicts over all of them */
            (void)heater_remember(c, applied, &clamped);
            heater_miss(c, &beyond);
        }
        status = heater_remember(c, applied, &clamped);
        heater_limit_held(c);
        heater_foresee(c, &beyond); /* before `see`: in the mode that the period had */
        heater_grow_older(c, missed);
        if (heater_see(c, mode) != HEATER_OK) {
            status = HEATER_BAD_MODE;
        }
        if (heater_observe(c, status != HEATER_BAD_MODE ? deviation : 0, &beyond, (reference == 0 ? 0 : followed), &astray) == 0) {
            missing = HEATER_BAD_STATE;
        } else if (astray != 0) {
            missing = HEATER_BAD_REFERENCE;
        }
        if (clamped != 0) {
            status = HEATER_CLAMPED;
        }
        status = heater_answer(c, status, beyond, missing);
        if (status > HEATER_SATURATED) {
            c->refused++;
        }
        c->late += (uint64_t)missed;
        c->samples++;
        if (missed > 0 && status <= HEATER_SATURATED) {
            status = HEATER_LATE;
        }
    }
    /*@ loop unroll HEATER_INPUTS; */
    for (i = 0; i < HEATER_INPUTS; i++) {
        u[i] = heater_sent(c->held[i], i);
    }
    return status;
}

heater_status heater_reset(heater_controller *c, const heater_real *u0, int32_t mode_age)
{
    int32_t i, j, clamped = 0, good = u0 != 0;
    if (c == 0) {
        return HEATER_NOT_READY;
    }
    if (good) {
        good = heater_all_usable(u0, HEATER_TAPS * HEATER_INPUTS, HEATER_BOUND);
    }
    c->ready = HEATER_READY;
    c->mode = -1;
    c->age = mode_age < 0 ? 0 : mode_age > HEATER_AGES ? HEATER_AGES : mode_age;
    c->timed = 0;
    c->origin = 0.0;
    c->last = -1.0;
    c->samples = c->refused = c->late = 0;
    heater_clear(c);
    heater_begin_observer(c);
    for (i = 0; i < HEATER_TAPS; i++) {
        for (j = 0; j < HEATER_INPUTS; j++) {
            c->held[j] = good ? heater_cut(u0[i * HEATER_INPUTS + j] - heater_REST_U[j], HEATER_BOUND, &clamped) : 0;
        }
        if (i < HEATER_TAPS - 1) {
            heater_push(c, c->held, &clamped); /* the last one is pushed by the first call */
            heater_note(c, c->held);
        }
    }
    heater_ask_held(c);
    return good || u0 == 0 ? HEATER_OK : HEATER_BAD_APPLIED;
}

heater_status heater_restore(heater_controller *c, const heater_controller *kept)
{
    if (c == 0 || kept == 0 || !heater_in_order(kept) || !heater_past_usable(kept)
        || !heater_all_usable(kept->held, HEATER_INPUTS, HEATER_BOUND)
        || !heater_observer_usable(kept)
        || !(kept->origin >= -1e18 && kept->origin <= 1e18)
        || !(kept->last >= -1.0 && kept->last <= HEATER_MOST_SAMPLES)) {
        return HEATER_NOT_READY;
    }
    *c = *kept;
    return HEATER_OK;
}

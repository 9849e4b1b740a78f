/* Controller of the law "averaged"

   Written by deadtime 0.1.0. C99; no malloc, no recursion, no globals; nothing but <stdint.h>.

   Call turntable_reset once, then turntable_update once every 0.01 s. All memory is one
   turntable_controller that the caller owns: 284 bytes, and as many controllers as you like.
   It is the whole state: a copy of it, kept, makes a warm restart (turntable_restore).
   Tables: 116 bytes of constants. Dense: a period costs one product a past input.

   The law is made for a plant that rests at x = 0 with u = 0. Where yours rests elsewhere, x,
   applied and u are deviations from there: subtract before the call, and add after it.
   Limits of the inputs: [-12.0] to [12.0].
   Units: x in those of the model's states, u of its inputs, time in seconds.
   A number beyond +-TURNTABLE_BOUND counts as not finite. */

#ifndef TURNTABLE_H
#define TURNTABLE_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef float turntable_real;

#define TURNTABLE_STEP 0.01   /* sampling period, s */
#define TURNTABLE_DELAY 0.25  /* input delay of the law's model, s */
#define TURNTABLE_STATES 2
#define TURNTABLE_INPUTS 1
#define TURNTABLE_MODES 2
#define TURNTABLE_READS_MODE 0  /* 0: the argument `mode` is not read */
#define TURNTABLE_READS_REFERENCE 0  /* 0: turntable_update has no argument `reference` */
#define TURNTABLE_AGES 1  /* rows of the table a mode, by the age of the mode in samples */
#define TURNTABLE_ROWS 1
#define TURNTABLE_TAPS 25  /* past inputs in the window */
#define TURNTABLE_BOUND 1099511627776.0f  /* 1e+12, of |x|, |applied| and |u| */

/* What became of a period. Above TURNTABLE_SATURATED the last input is held, but for LATE. */
typedef enum {
    TURNTABLE_OK = 0,
    TURNTABLE_SATURATED = 1,     /* the law asked for more than the limits allow */
    TURNTABLE_BAD_STATE = 2,     /* x is not finite */
    TURNTABLE_BAD_MODE = 3,      /* the mode is none of the plant's */
    TURNTABLE_BAD_APPLIED = 4,   /* the applied input is not finite: the held one is taken */
    TURNTABLE_OVERFLOW = 5,      /* the law's answer, or x, is beyond TURNTABLE_BOUND */
    TURNTABLE_LATE = 7,          /* whole periods without a call: their input counts as held */
    TURNTABLE_OUT_OF_ORDER = 8,  /* the period of this call has been served: nothing is done */
    TURNTABLE_CLAMPED = 9,       /* the past left its bounds, which no history can do: memory damaged */
    TURNTABLE_NOT_READY = 10     /* never reset, or damaged, or a pointer is 0: reset, then go on */
} turntable_status;

/* Everything that the next periods depend on. */
typedef struct {
    uint32_t ready;  /* TURNTABLE_READY after a reset */
    int32_t place;   /* of the next input in the ring */
    int32_t mode;    /* the last known, -1 before there was one */
    int32_t age;     /* of the mode, samples; TURNTABLE_AGES and more are one */
    int32_t timed;   /* whether a call has brought a time */
    double origin;   /* time of sample 0, s */
    double last;     /* the last sample served */
    uint64_t samples, refused, late;
    turntable_real held[TURNTABLE_INPUTS];  /* the input in force */
    turntable_real ring[2 * TURNTABLE_TAPS * TURNTABLE_INPUTS];  /* twice: the last N inputs stand in a row */
} turntable_controller;

#define TURNTABLE_READY 0xf36927fdu  /* of these tables: another law's state is none of this one's */

/*@ predicate turntable_within(turntable_controller *c) =
      c->ready == TURNTABLE_READY && 0 <= c->place < TURNTABLE_TAPS &&
      -1 <= c->mode < TURNTABLE_MODES && 0 <= c->age <= TURNTABLE_AGES &&
      0 <= c->timed <= 1 && -1e18 <= c->origin <= 1e18 && -1.0 <= c->last <= 9e15 &&
      (\forall integer i; 0 <= i < TURNTABLE_INPUTS ==>
          -TURNTABLE_BOUND <= c->held[i] <= TURNTABLE_BOUND) &&
      (\forall integer i; 0 <= i < 2 * TURNTABLE_TAPS * TURNTABLE_INPUTS ==>
          -TURNTABLE_BOUND <= c->ring[i] <= TURNTABLE_BOUND);
*/

/* Start anew after the inputs u0, the oldest first; 0: they were all 0. `mode_age`: age of the
   first mode, samples. BAD_APPLIED if u0 is not finite: then it counts as 0. */
/*@ requires \valid(c);
    requires u0 == \null || \valid_read(u0 + (0 .. TURNTABLE_TAPS * TURNTABLE_INPUTS - 1));
    ensures turntable_within(c);
    ensures \result == TURNTABLE_OK || \result == TURNTABLE_BAD_APPLIED; */
turntable_status turntable_reset(turntable_controller *c, const turntable_real *u0, int32_t mode_age);

/* The input u of this period.

   x: the state; mode: as sampled with it; applied: what the actuator was given in the period that
   ends if it was not what the last call returned, or 0; time: of this sample, on any clock that
   goes on, or 0: the next period. The call belongs to the sample that `time` is nearest to. */
/*@ requires \valid(c) && turntable_within(c);
    requires \valid_read(x + (0 .. TURNTABLE_STATES - 1));
    requires applied == \null || \valid_read(applied + (0 .. TURNTABLE_INPUTS - 1));
    requires time == \null || \valid_read(time);
    requires \valid(u + (0 .. TURNTABLE_INPUTS - 1));
    requires \separated(c, x + (0 .. TURNTABLE_STATES - 1), u + (0 .. TURNTABLE_INPUTS - 1));
    ensures turntable_within(c);
    ensures \forall integer i; 0 <= i < TURNTABLE_INPUTS ==>
        -TURNTABLE_BOUND <= u[i] <= TURNTABLE_BOUND;
    ensures TURNTABLE_OK <= \result <= TURNTABLE_NOT_READY; */
turntable_status turntable_update(turntable_controller *c, const turntable_real *x, int32_t mode,
                       const turntable_real *applied, const double *time, turntable_real *u);

/* Go on from a kept copy; NOT_READY, and `c` as it was, if that is no state of this controller. */
/*@ requires \valid(c) && \valid_read(kept);
    ensures \result == TURNTABLE_OK || \result == TURNTABLE_NOT_READY; */
turntable_status turntable_restore(turntable_controller *c, const turntable_controller *kept);

#ifdef __cplusplus
}
#endif
#endif

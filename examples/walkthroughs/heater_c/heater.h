/* Controller of the law "expected, observed"

   Written by deadtime 0.1.0. C99; no malloc, no recursion, no globals; nothing but <stdint.h>.

   Call heater_reset once, then heater_update once every 4.0 s. All memory is one
   heater_controller that the caller owns: 864 bytes, and as many controllers as you like.
   It is the whole state: a copy of it, kept, makes a warm restart (heater_restore).
   Tables: 79952 bytes of constants. Dense: a period costs one product a past input.

   y, reference, applied and u are absolute, as sensors and actuators have them. The operating point is in here:
   x[0] = 59.97 with u[0] = 44.98.
   It is subtracted from what comes in and added to u: do not do so again outside.
   Limits of the inputs: [-44.98238766715627] to [55.01761233284373].
   Outputs y are measured. Where one is missing, none corrects the estimate, which is predicted on;
   so it is where the mode is unknown.
   z is what the law is given: the estimate of x, the sums of the
   tracking errors, and the reference.
   Units: y in those of the model's outputs, u of its inputs, time in seconds.
   A number beyond +-HEATER_BOUND counts as not finite. */

#ifndef HEATER_H
#define HEATER_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef double heater_real;

#define HEATER_STEP 4.0   /* sampling period, s */
#define HEATER_DELAY 118.98497363611395  /* longest input delay of the law's model, s */
#define HEATER_OUTPUTS 1
#define HEATER_ESTIMATES 1  /* z[0] and on: the states, then disturbances if they are estimated */
#define HEATER_SUMS 1  /* the next in z */
#define HEATER_TRACKED 1  /* references, the last in z */
#define HEATER_STATES 3  /* z as a whole */
#define HEATER_SENT 31  /* past inputs that the observer reads */
#define HEATER_INPUTS 1
#define HEATER_MODES 2
#define HEATER_READS_MODE 1  /* 0: the argument `mode` is not read */
#define HEATER_READS_REFERENCE 1  /* 0: heater_update has no argument `reference` */
#define HEATER_AGES 151  /* rows of the table a mode, by the age of the mode in samples */
#define HEATER_ROWS 302
#define HEATER_TAPS 30  /* past inputs in the window */
#define HEATER_BOUND 8749002899132047697490008908470485461412677723572849745703082425639811996797503692894052708092215296.0  /* 9e+99, of |y|, |applied| and |u|, and in z */
#define HEATER_Y0 {59.97289774611773}  /* y of the plant at rest, an initializer */
#define HEATER_U0 {44.98238766715627}  /* and u */

/* What became of a period. Above HEATER_SATURATED the last input is held, but for BAD_STATE,
   BAD_REFERENCE and LATE. */
typedef enum {
    HEATER_OK = 0,
    HEATER_SATURATED = 1,     /* the law asked for more than the limits allow */
    HEATER_BAD_STATE = 2,     /* y is not finite: nothing is corrected */
    HEATER_BAD_MODE = 3,      /* the mode is none of the plant's */
    HEATER_BAD_APPLIED = 4,   /* the applied input is not finite: the held one is taken */
    HEATER_OVERFLOW = 5,      /* the law's answer, or the estimate, is beyond HEATER_BOUND */
    HEATER_BAD_REFERENCE = 6, /* the reference is not finite: the last one goes on */
    HEATER_LATE = 7,          /* whole periods without a call: their input counts as held */
    HEATER_OUT_OF_ORDER = 8,  /* the period of this call has been served: nothing is done */
    HEATER_CLAMPED = 9,       /* the past left its bounds, which no history can do: memory damaged */
    HEATER_NOT_READY = 10     /* never reset, or damaged, or a pointer is 0: reset, then go on */
} heater_status;

/* Everything that the next periods depend on. */
typedef struct {
    uint32_t ready;  /* HEATER_READY after a reset */
    int32_t place;   /* of the next input in the ring */
    int32_t mode;    /* the last known, -1 before there was one */
    int32_t age;     /* of the mode, samples; HEATER_AGES and more are one */
    int32_t timed;   /* whether a call has brought a time */
    double origin;   /* time of sample 0, s */
    double last;     /* the last sample served */
    uint64_t samples, refused, late;
    heater_real held[HEATER_INPUTS];  /* the input in force */
    heater_real ring[2 * HEATER_TAPS * HEATER_INPUTS];  /* twice: the last N inputs stand in a row */
    heater_real z[HEATER_STATES];  /* what the law is given */
    heater_real before[HEATER_TRACKED];  /* tracked outputs at the last sample */
    heater_real asked[HEATER_INPUTS];  /* what the law asked for, before the limits */
    heater_real sent[HEATER_SENT][HEATER_INPUTS];  /* the last inputs as applied */
    int32_t next;    /* of the next input in `sent` */
} heater_controller;

#define HEATER_READY 0xf2a14e1du  /* of these tables: another law's state is none of this one's */

/*@ predicate heater_within(heater_controller *c) =
      c->ready == HEATER_READY && 0 <= c->place < HEATER_TAPS &&
      -1 <= c->mode < HEATER_MODES && 0 <= c->age <= HEATER_AGES &&
      0 <= c->timed <= 1 && -1e18 <= c->origin <= 1e18 && -1.0 <= c->last <= 9e15 &&
      (\forall integer i; 0 <= i < HEATER_INPUTS ==>
          -HEATER_BOUND <= c->held[i] <= HEATER_BOUND) &&
      (\forall integer i; 0 <= i < HEATER_STATES ==>
          -HEATER_BOUND <= c->z[i] <= HEATER_BOUND) &&
      (\forall integer i; 0 <= i < HEATER_TRACKED ==>
          -HEATER_BOUND <= c->before[i] <= HEATER_BOUND) &&
      (\forall integer i; 0 <= i < HEATER_INPUTS ==>
          -HEATER_BOUND <= c->asked[i] <= HEATER_BOUND) &&
      0 <= c->next < HEATER_SENT &&
      (\forall integer i, j; 0 <= i < HEATER_SENT && 0 <= j < HEATER_INPUTS ==>
          -HEATER_BOUND <= c->sent[i][j] <= HEATER_BOUND) &&
      (\forall integer i; 0 <= i < 2 * HEATER_TAPS * HEATER_INPUTS ==>
          -HEATER_BOUND <= c->ring[i] <= HEATER_BOUND);
*/

/* Start anew after the inputs u0, the oldest first; 0: the plant was at rest. `mode_age`: age of the
   first mode, samples. BAD_APPLIED if u0 is not finite: then it counts as not given. */
/*@ requires \valid(c);
    requires u0 == \null || \valid_read(u0 + (0 .. HEATER_TAPS * HEATER_INPUTS - 1));
    ensures heater_within(c);
    ensures \result == HEATER_OK || \result == HEATER_BAD_APPLIED; */
heater_status heater_reset(heater_controller *c, const heater_real *u0, int32_t mode_age);

/* The input u of this period.

   y: the outputs; mode: as sampled with them; applied: what the actuator was given in the period that
   ends if it was not what the last call returned, or 0;
   reference: what the tracked outputs are to follow, or 0: the law's own;
   time: of this sample, on any clock that goes on, or 0: the next period. The call belongs to the
   sample that `time` is nearest to. */
/*@ requires \valid(c) && heater_within(c);
    requires \valid_read(y + (0 .. HEATER_OUTPUTS - 1));
    requires applied == \null || \valid_read(applied + (0 .. HEATER_INPUTS - 1));
    requires reference == \null || \valid_read(reference + (0 .. HEATER_TRACKED - 1));
    requires time == \null || \valid_read(time);
    requires \valid(u + (0 .. HEATER_INPUTS - 1));
    requires \separated(c, y + (0 .. HEATER_OUTPUTS - 1), u + (0 .. HEATER_INPUTS - 1));
    ensures heater_within(c);
    ensures \forall integer i; 0 <= i < HEATER_INPUTS ==>
        -HEATER_BOUND <= u[i] <= HEATER_BOUND;
    ensures HEATER_OK <= \result <= HEATER_NOT_READY; */
heater_status heater_update(heater_controller *c, const heater_real *y, int32_t mode,
                       const heater_real *applied, const heater_real *reference,
                       const double *time, heater_real *u);

/* Go on from a kept copy; NOT_READY, and `c` as it was, if that is no state of this controller. */
/*@ requires \valid(c) && \valid_read(kept);
    ensures \result == HEATER_OK || \result == HEATER_NOT_READY; */
heater_status heater_restore(heater_controller *c, const heater_controller *kept);

#ifdef __cplusplus
}
#endif
#endif

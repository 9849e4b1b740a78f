/* For Frama-C: one call of heater_update from any state within the bounds of heater.h.
   Written by deadtime 0.1.0. The command is that of `make eva`.

   With -DHOSTILE and -warn-special-float none, x, applied and time are any bits, NaN among them. */

#ifdef __FRAMAC__ /* what compiles *.c finds nothing here */

#include <__fc_builtin.h>

#include "heater.h"

typedef heater_real real;

#define ANY(bound) Frama_C_double_interval(-(bound), bound)

static void any(real *values, int32_t count, real bound)
{
    int32_t i;
    /*@ loop unroll 994; */
    for (i = 0; i < count; i++) {
        values[i] = ANY(bound);
    }
}

void from_any_state(void)
{
    static heater_controller c;
    real y[HEATER_OUTPUTS], applied[HEATER_INPUTS], u[HEATER_INPUTS];
    real reference[HEATER_TRACKED];
    double time;
    int32_t mode = Frama_C_interval(-2147483647 - 1, 2147483647);
    heater_status status;

    c.ready = HEATER_READY;
    c.place = Frama_C_interval(0, HEATER_TAPS - 1);
    c.mode = Frama_C_interval(-1, HEATER_MODES - 1);
    c.age = Frama_C_interval(0, HEATER_AGES);
    c.timed = Frama_C_interval(0, 1);
    c.origin = Frama_C_double_interval(-1e18, 1e18);
    c.last = Frama_C_double_interval(-1.0, 9e15);
    c.samples = Frama_C_unsigned_long_interval(0, 18446744073709551615ul);
    c.refused = Frama_C_unsigned_long_interval(0, 18446744073709551615ul);
    c.late = Frama_C_unsigned_long_interval(0, 18446744073709551615ul);
    any(c.held, HEATER_INPUTS, HEATER_BOUND);
    any(c.ring, 2 * HEATER_TAPS * HEATER_INPUTS, HEATER_BOUND);
    any(c.z, HEATER_STATES, HEATER_BOUND);
    any(c.before, HEATER_TRACKED, HEATER_BOUND);
    any(c.asked, HEATER_INPUTS, HEATER_BOUND);
    c.next = Frama_C_interval(0, HEATER_SENT - 1);
    any(&c.sent[0][0], HEATER_SENT * HEATER_INPUTS, HEATER_BOUND);
#ifdef HOSTILE
    Frama_C_make_unknown((char *)y, sizeof y);
    Frama_C_make_unknown((char *)reference, sizeof reference);
    Frama_C_make_unknown((char *)applied, sizeof applied);
    Frama_C_make_unknown((char *)&time, sizeof time);
#else
    any(y, HEATER_OUTPUTS, 1.7976931348623157e+308);
    any(reference, HEATER_TRACKED, 1.7976931348623157e+308);
    any(applied, HEATER_INPUTS, 1.7976931348623157e+308);
    time = Frama_C_double_interval(-1.7976931348623157e308, 1.7976931348623157e308);
#endif
    status = heater_update(&c, y, mode, Frama_C_interval(0, 1) ? applied : 0,
                      Frama_C_interval(0, 1) ? reference : 0, Frama_C_interval(0, 1) ? &time : 0, u);
    /*@ assert within: heater_within(&c); */
    /*@ assert answer: \forall integer i; 0 <= i < HEATER_INPUTS ==>
            -HEATER_BOUND <= u[i] <= HEATER_BOUND; */
    /*@ assert defined: HEATER_OK <= status <= HEATER_NOT_READY; */
}

#else
typedef int heater_needs_frama_c; /* C99 wants a declaration in every file */
#endif

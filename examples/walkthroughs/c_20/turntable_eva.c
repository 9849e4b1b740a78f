/* For Frama-C: one call of turntable_update from any state within the bounds of turntable.h.
   Written by deadtime 0.1.0. The command is that of `make eva`.

   With -DHOSTILE and -warn-special-float none, x, applied and time are any bits, NaN among them. */

#ifdef __FRAMAC__ /* what compiles *.c finds nothing here */

#include <__fc_builtin.h>

#include "turntable.h"

typedef turntable_real real;

#define ANY(bound) Frama_C_float_interval(-(bound), bound)

static void any(real *values, int32_t count, real bound)
{
    int32_t i;
    /*@ loop unroll 62; */
    for (i = 0; i < count; i++) {
        values[i] = ANY(bound);
    }
}

void from_any_state(void)
{
    static turntable_controller c;
    real x[TURNTABLE_STATES], applied[TURNTABLE_INPUTS], u[TURNTABLE_INPUTS];
    double time;
    int32_t mode = Frama_C_interval(-2147483647 - 1, 2147483647);
    turntable_status status;

    c.ready = TURNTABLE_READY;
    c.place = Frama_C_interval(0, TURNTABLE_TAPS - 1);
    c.mode = Frama_C_interval(-1, TURNTABLE_MODES - 1);
    c.age = Frama_C_interval(0, TURNTABLE_AGES);
    c.timed = Frama_C_interval(0, 1);
    c.origin = Frama_C_double_interval(-1e18, 1e18);
    c.last = Frama_C_double_interval(-1.0, 9e15);
    c.samples = Frama_C_unsigned_long_interval(0, 18446744073709551615ul);
    c.refused = Frama_C_unsigned_long_interval(0, 18446744073709551615ul);
    c.late = Frama_C_unsigned_long_interval(0, 18446744073709551615ul);
    any(c.held, TURNTABLE_INPUTS, TURNTABLE_BOUND);
    any(c.ring, 2 * TURNTABLE_TAPS * TURNTABLE_INPUTS, TURNTABLE_BOUND);
#ifdef HOSTILE
    Frama_C_make_unknown((char *)x, sizeof x);
    Frama_C_make_unknown((char *)applied, sizeof applied);
    Frama_C_make_unknown((char *)&time, sizeof time);
#else
    any(x, TURNTABLE_STATES, 3.4028235e+38f);
    any(applied, TURNTABLE_INPUTS, 3.4028235e+38f);
    time = Frama_C_double_interval(-1.7976931348623157e308, 1.7976931348623157e308);
#endif
    status = turntable_update(&c, x, mode, Frama_C_interval(0, 1) ? applied : 0,
                      Frama_C_interval(0, 1) ? &time : 0, u);
    /*@ assert within: turntable_within(&c); */
    /*@ assert answer: \forall integer i; 0 <= i < TURNTABLE_INPUTS ==>
            -TURNTABLE_BOUND <= u[i] <= TURNTABLE_BOUND; */
    /*@ assert defined: TURNTABLE_OK <= status <= TURNTABLE_NOT_READY; */
}

#else
typedef int turntable_needs_frama_c; /* C99 wants a declaration in every file */
#endif

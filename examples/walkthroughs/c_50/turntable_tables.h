/* Tables of turntable.c: 36 bytes, all constant. Written by deadtime 0.1.0. */

#ifndef TURNTABLE_TABLES_H
#define TURNTABLE_TABLES_H

/* gains of the state */
static const turntable_real turntable_F[1][1][2] =
{
    {
        {-2.6e+00f, -1.2061541e+00f}
    }
};

/* taps, the oldest input first */
static const turntable_real turntable_G[1][1][5] =
{
    {
        {-4.4644696e-01f, -4.3137285e-01f, -4.151219e-01f, -3.975967e-01f, -3.7869117e-01f}
    }
};

/* limits of the inputs */
static const turntable_real turntable_LOW[1] =
{-1.2e+01f};

/* limits of the inputs */
static const turntable_real turntable_HIGH[1] =
{1.2e+01f};

#endif

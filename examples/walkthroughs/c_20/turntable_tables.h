/* Tables of turntable.c: 68 bytes, all constant. Written by deadtime 0.1.0. */

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
static const turntable_real turntable_G[1][1][13] =
{
    {
        {-9.04419e-02f, -1.7917235e-01f, -1.768327e-01f, -1.7442185e-01f, -1.7193751e-01f, -1.6937728e-01f,
         -1.6673876e-01f, -1.6401938e-01f, -1.6121653e-01f, -1.5832749e-01f, -1.5534948e-01f, -1.5227957e-01f,
         -1.4911479e-01f}
    }
};

/* limits of the inputs */
static const turntable_real turntable_LOW[1] =
{-1.2e+01f};

/* limits of the inputs */
static const turntable_real turntable_HIGH[1] =
{1.2e+01f};

#endif

/* Tables of turntable.c: 180 bytes, all constant. Written by deadtime 0.1.0. */

#ifndef TURNTABLE_TABLES_H
#define TURNTABLE_TABLES_H

/* gains of the state */
static const turntable_real turntable_F[1][1][2] =
{
    {
        {-2.6e+00f, -1.2061541e+00f}
    }
};

/* one period of the factorisation */
static const turntable_real turntable_S[4][4] =
{
    {1e+00f, 4.9750833e-03f, 0e+00f, 0e+00f},
    {0e+00f, 9.9004984e-01f, 0e+00f, 0e+00f},
    {0e+00f, 0e+00f, 1e+00f, 4.9844077e-03f},
    {0e+00f, 0e+00f, 0e+00f, 9.9376947e-01f}
};

/* an input, in the factorisation */
static const turntable_real turntable_GAMMA[4][1] =
{
    {1.2458437e-04f},
    {4.975083e-02f},
    {7.79625e-05f},
    {3.1152546e-02f}
};

/* S to the power of a block's length */
static const turntable_real turntable_WHOLE[4][4] =
{
    {1e+00f, 1.1059961e-01f, 0e+00f, 0e+00f},
    {0e+00f, 7.788008e-01f, 0e+00f, 0e+00f},
    {0e+00f, 0e+00f, 1e+00f, 1.1572374e-01f},
    {0e+00f, 0e+00f, 0e+00f, 8.553453e-01f}
};

/* rows of the factorisation */
static const turntable_real turntable_H[1][1][4] =
{
    {
        {-1e+00f, -3.5e-01f, -1.6e+00f, -6.2e-01f}
    }
};

/* taps of the oldest input */
static const turntable_real turntable_LAST[1][1][1] =
{
    {
        {-4.529137e-02f}
    }
};

/* limits of the inputs */
static const turntable_real turntable_LOW[1] =
{-1.2e+01f};

/* limits of the inputs */
static const turntable_real turntable_HIGH[1] =
{1.2e+01f};

#endif

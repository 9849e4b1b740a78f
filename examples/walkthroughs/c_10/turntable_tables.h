/* Tables of turntable.c: 116 bytes, all constant. Written by deadtime 0.1.0. */

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
static const turntable_real turntable_G[1][1][25] =
{
    {
        {-9.04419e-02f, -8.987427e-02f, -8.9298084e-02f, -8.871321e-02f, -8.81195e-02f, -8.751682e-02f,
         -8.690503e-02f, -8.628398e-02f, -8.565352e-02f, -8.501351e-02f, -8.436378e-02f, -8.370419e-02f,
         -8.303457e-02f, -8.235476e-02f, -8.166461e-02f, -8.096394e-02f, -8.025258e-02f, -7.9530366e-02f,
         -7.879712e-02f, -7.805266e-02f, -7.729681e-02f, -7.652938e-02f, -7.575019e-02f, -7.495904e-02f,
         -7.415575e-02f}
    }
};

/* limits of the inputs */
static const turntable_real turntable_LOW[1] =
{-1.2e+01f};

/* limits of the inputs */
static const turntable_real turntable_HIGH[1] =
{1.2e+01f};

#endif

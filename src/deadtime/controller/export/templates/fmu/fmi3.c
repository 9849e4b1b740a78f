/* FMI 3.0 for co-simulation, around model.h. */

#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

#ifdef FMI_HEADERS
#include "fmi3Functions.h"
#else
typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean, fmi3Clock;
typedef const char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const uint8_t *fmi3Binary;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum { fmi3Independent } fmi3DependencyKind;
typedef enum { fmi3IntervalNotYetKnown } fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3IntermediateUpdateCallback)(fmi3InstanceEnvironment, fmi3Float64, fmi3Boolean,
                                               fmi3Boolean, fmi3Boolean, fmi3Boolean,
                                               fmi3Boolean *, fmi3Float64 *);
typedef void (*fmi3LockPreemptionCallback)();
typedef void (*fmi3UnlockPreemptionCallback)();
#endif

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef fmi3Instance Self;
typedef const fmi3ValueReference References[];

typedef struct {
    model m;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
} instance;

static fmi3Status answer(instance *c, const char *complaint)
{
    if (complaint == 0) {
        return fmi3OK;
    }
    if (c->log != 0) {
        c->log(c->environment, fmi3Error, "logStatusError", complaint);
    }
    return fmi3Error;
}

static const char setters[] = MODEL_SETTERS;

/* Whether a variable may be set now. */
static int settable(const instance *c, fmi3ValueReference vr)
{
    return setters[vr] == INPUT || (setters[vr] == PARAMETER && c->m.phase < STEPPING);
}

/* What is read in initialization mode follows what has been set. */
static void follow(instance *c)
{
    if (c->m.phase == INITIALIZING) {
        (void)model_begin(&c->m, c->m.start);
    }
}

/* The model is ready in the next phase. */
static fmi3Status begin(instance *c, int32_t phase)
{
    if (c->m.phase != phase - 1) {
        return answer(c, "initialization mode is entered once, and left once");
    }
    c->m.phase = phase;
    return answer(c, model_begin(&c->m, c->m.start));
}

static fmi3Status step(instance *c, double time, double size)
{
    const char *refusal = model_refuses(&c->m, time, size);
    return answer(c, refusal != 0 ? refusal : model_step(&c->m, time, size));
}

EXPORT const char *fmi3GetVersion(void)
{
    return "3.0";
}

EXPORT fmi3Status fmi3SetDebugLogging(Self c, fmi3Boolean on, size_t n, const fmi3String names[])
{
    return fmi3OK;
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, References required, size_t n,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update)
{
    instance *c = calloc(1, sizeof *c);
    if (c == 0) {
        return 0;
    }
    c->log = log;
    c->environment = environment;
    if (token == 0 || strcmp(token, MODEL_TOKEN) != 0) {
        (void)answer(c, "the instantiation token is not that of this FMU");
        free(c);
        return 0;
    }
    model_defaults(&c->m);
    return c;
}

EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token,
                                                 fmi3String resources, fmi3Boolean visible,
                                                 fmi3Boolean logging,
                                                 fmi3InstanceEnvironment environment,
                                                 fmi3LogMessageCallback log)
{
    return 0;
}

EXPORT fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3ClockUpdateCallback clock, fmi3LockPreemptionCallback lock,
    fmi3UnlockPreemptionCallback unlock)
{
    return 0;
}

EXPORT void fmi3FreeInstance(Self c)
{
    free(c);
}

EXPORT fmi3Status fmi3EnterInitializationMode(Self c, fmi3Boolean defined, fmi3Float64 tolerance,
                                              fmi3Float64 start, fmi3Boolean ends,
                                              fmi3Float64 stop)
{
    if (!(start >= -1e17 && start <= 1e17)) {
        return answer(c, "the start must be a finite time");
    }
    ((instance *)c)->m.start = start;
    return begin(c, INITIALIZING);
}

EXPORT fmi3Status fmi3ExitInitializationMode(Self c)
{
    return begin(c, STEPPING);
}

EXPORT fmi3Status fmi3Terminate(Self c)
{
    ((instance *)c)->m.phase = TERMINATED;
    return fmi3OK;
}

EXPORT fmi3Status fmi3Reset(Self c)
{
    model_defaults(&((instance *)c)->m);
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetFloat64(Self c, References vr, size_t n, fmi3Float64 values[], size_t nv)
{
    size_t i;
    follow(c);
    for (i = 0; i < n; i++) {
        if (vr[i] >= (unsigned)REALS || i >= nv) {
            return answer(c, "no such value reference");
        }
        values[i] = ((instance *)c)->m.real[vr[i]];
    }
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetFloat64(Self c, References vr, size_t n, const fmi3Float64 values[],
                                 size_t nv)
{
    size_t i;
    for (i = 0; i < n; i++) {
        if (vr[i] >= (unsigned)REALS || i >= nv) {
            return answer(c, "no such value reference");
        }
        if (!settable(c, vr[i])) {
            return answer(c, "this variable cannot be set now");
        }
        ((instance *)c)->m.real[vr[i]] = values[i];
    }
    return fmi3OK;
}

/* Value references of a kind begin at `first`. */
#define ACCESS(Kind, type, field, first, count)                                                 \
    EXPORT fmi3Status fmi3Get##Kind(Self c, References vr, size_t n, type values[], size_t nv)  \
    {                                                                                           \
        size_t i;                                                                               \
        follow(c);                                                                              \
        for (i = 0; i < n; i++) {                                                               \
            if (vr[i] < (first) || vr[i] >= (first) + (count) || i >= nv) {                     \
                return answer(c, "no such value reference");                                    \
            }                                                                                   \
            values[i] = (type)((instance *)c)->m.field[vr[i] - (first)];                        \
        }                                                                                       \
        return fmi3OK;                                                                          \
    }                                                                                           \
    EXPORT fmi3Status fmi3Set##Kind(Self c, References vr, size_t n, const type values[],       \
                                    size_t nv)                                                  \
    {                                                                                           \
        size_t i;                                                                               \
        for (i = 0; i < n; i++) {                                                               \
            if (vr[i] < (first) || vr[i] >= (first) + (count) || i >= nv) {                     \
                return answer(c, "no such value reference");                                    \
            }                                                                                   \
            if (!settable(c, vr[i])) {                                                          \
                return answer(c, "this variable cannot be set now");                            \
            }                                                                                   \
            ((instance *)c)->m.field[vr[i] - (first)] = values[i];                              \
        }                                                                                       \
        return fmi3OK;                                                                          \
    }

ACCESS(Int32, fmi3Int32, integer, (unsigned)REALS, (unsigned)INTEGERS)
ACCESS(Boolean, fmi3Boolean, boolean, (unsigned)(REALS + INTEGERS), (unsigned)BOOLEANS)

/* What no variable is. */
#define NO_VALUES(Kind)                                                                         \
    EXPORT fmi3Status fmi3Get##Kind(Self c, References vr, size_t n, fmi3##Kind values[],       \
                                    size_t nv)                                                  \
    {                                                                                           \
        return n > 0 ? answer(c, "no variable is of this type") : fmi3OK;                       \
    }                                                                                           \
    EXPORT fmi3Status fmi3Set##Kind(Self c, References vr, size_t n, const fmi3##Kind values[], \
                                    size_t nv)                                                  \
    {                                                                                           \
        return n > 0 ? answer(c, "no variable is of this type") : fmi3OK;                       \
    }

NO_VALUES(Float32)
NO_VALUES(Int8)
NO_VALUES(UInt8)
NO_VALUES(Int16)
NO_VALUES(UInt16)
NO_VALUES(UInt32)
NO_VALUES(Int64)
NO_VALUES(UInt64)
NO_VALUES(String)

EXPORT fmi3Status fmi3DoStep(Self c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean keep,
                             fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early,
                             fmi3Float64 *last)
{
    fmi3Status status = step(c, time, size);
    *event = *terminate = *early = false;
    *last = ((instance *)c)->m.real[0];
    return status;
}

/* States are copies of the model. */
EXPORT fmi3Status fmi3GetFMUState(Self c, fmi3FMUState *state)
{
    if (*state == 0) {
        *state = malloc(sizeof(model));
    }
    if (*state == 0) {
        return answer(c, "no memory");
    }
    memcpy(*state, &((instance *)c)->m, sizeof(model));
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetFMUState(Self c, fmi3FMUState state)
{
    memcpy(&((instance *)c)->m, state, sizeof(model));
    return fmi3OK;
}

EXPORT fmi3Status fmi3FreeFMUState(Self c, fmi3FMUState *state)
{
    free(*state);
    *state = 0;
    return fmi3OK;
}

EXPORT fmi3Status fmi3SerializedFMUStateSize(Self c, fmi3FMUState state, size_t *size)
{
    *size = sizeof(model);
    return fmi3OK;
}

EXPORT fmi3Status fmi3SerializeFMUState(Self c, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    if (size < sizeof(model)) {
        return answer(c, "too little room for a state");
    }
    memcpy(bytes, state, sizeof(model));
    return fmi3OK;
}

EXPORT fmi3Status fmi3DeserializeFMUState(Self c, const fmi3Byte bytes[], size_t size,
                                          fmi3FMUState *state)
{
    if (size < sizeof(model)) {
        return answer(c, "too few bytes for a state");
    }
    *state = malloc(sizeof(model));
    if (*state == 0) {
        return answer(c, "no memory");
    }
    memcpy(*state, bytes, sizeof(model));
    return fmi3OK;
}

/* What a co-simulation without clocks, events and derivatives has no use for. */
#define NOT_HERE(name, ...)                                                                     \
    EXPORT fmi3Status name(Self c, __VA_ARGS__)                                                 \
    {                                                                                           \
        return answer(c, #name " is not supported");                                            \
    }
#define NOT_HERE_PLAIN(name)                                                                    \
    EXPORT fmi3Status name(Self c)                                                              \
    {                                                                                           \
        return answer(c, #name " is not supported");                                            \
    }

NOT_HERE(fmi3GetBinary, References vr, size_t n, size_t sizes[], fmi3Binary values[], size_t nv)
NOT_HERE(fmi3SetBinary, References vr, size_t n, const size_t sizes[], const fmi3Binary values[],
         size_t nv)
NOT_HERE(fmi3GetClock, References vr, size_t n, fmi3Clock values[])
NOT_HERE(fmi3SetClock, References vr, size_t n, const fmi3Clock values[])
NOT_HERE(fmi3GetNumberOfVariableDependencies, fmi3ValueReference vr, size_t *n)
NOT_HERE(fmi3GetVariableDependencies, fmi3ValueReference vr, size_t of[],
         fmi3ValueReference independents[], size_t on[], fmi3DependencyKind kinds[], size_t n)
NOT_HERE(fmi3GetDirectionalDerivative, References unknowns, size_t n, References knowns, size_t m,
         const fmi3Float64 seed[], size_t seeds, fmi3Float64 sensitivity[], size_t count)
NOT_HERE(fmi3GetAdjointDerivative, References unknowns, size_t n, References knowns, size_t m,
         const fmi3Float64 seed[], size_t seeds, fmi3Float64 sensitivity[], size_t count)
NOT_HERE(fmi3GetIntervalDecimal, References vr, size_t n, fmi3Float64 intervals[],
         fmi3IntervalQualifier qualifiers[])
NOT_HERE(fmi3GetIntervalFraction, References vr, size_t n, fmi3UInt64 counters[],
         fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
NOT_HERE(fmi3GetShiftDecimal, References vr, size_t n, fmi3Float64 shifts[])
NOT_HERE(fmi3GetShiftFraction, References vr, size_t n, fmi3UInt64 counters[],
         fmi3UInt64 resolutions[])
NOT_HERE(fmi3SetIntervalDecimal, References vr, size_t n, const fmi3Float64 intervals[])
NOT_HERE(fmi3SetIntervalFraction, References vr, size_t n, const fmi3UInt64 counters[],
         const fmi3UInt64 resolutions[])
NOT_HERE(fmi3SetShiftDecimal, References vr, size_t n, const fmi3Float64 shifts[])
NOT_HERE(fmi3SetShiftFraction, References vr, size_t n, const fmi3UInt64 counters[],
         const fmi3UInt64 resolutions[])
NOT_HERE(fmi3UpdateDiscreteStates, fmi3Boolean *need, fmi3Boolean *terminate,
         fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *next)
NOT_HERE(fmi3CompletedIntegratorStep, fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *terminate)
NOT_HERE(fmi3SetTime, fmi3Float64 time)
NOT_HERE(fmi3SetContinuousStates, const fmi3Float64 states[], size_t n)
NOT_HERE(fmi3GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t n)
NOT_HERE(fmi3GetEventIndicators, fmi3Float64 indicators[], size_t n)
NOT_HERE(fmi3GetContinuousStates, fmi3Float64 states[], size_t n)
NOT_HERE(fmi3GetNominalsOfContinuousStates, fmi3Float64 nominals[], size_t n)
NOT_HERE(fmi3GetNumberOfEventIndicators, size_t *n)
NOT_HERE(fmi3GetNumberOfContinuousStates, size_t *n)
NOT_HERE(fmi3GetOutputDerivatives, References vr, size_t n, const fmi3Int32 orders[],
         fmi3Float64 values[], size_t nv)
NOT_HERE(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)
NOT_HERE_PLAIN(fmi3EnterEventMode)
NOT_HERE_PLAIN(fmi3EnterConfigurationMode)
NOT_HERE_PLAIN(fmi3ExitConfigurationMode)
NOT_HERE_PLAIN(fmi3EvaluateDiscreteStates)
NOT_HERE_PLAIN(fmi3EnterContinuousTimeMode)
NOT_HERE_PLAIN(fmi3EnterStepMode)

/* FMI 2.0 for co-simulation, around model.h. No memory callbacks are used. */

#include <stdlib.h>
#include <string.h>

#include "model.h"

#ifdef FMI_HEADERS
#include "fmi2Functions.h"
#else
typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum {
    fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated
} fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;
#endif

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef struct {
    model m;
    fmi2CallbackFunctions callbacks;
    char name[64];
} instance;

static fmi2Status answer(instance *c, const char *complaint)
{
    if (complaint == 0) {
        return fmi2OK;
    }
    if (c->callbacks.logger != 0) {
        c->callbacks.logger(c->callbacks.componentEnvironment, c->name, fmi2Error, "logStatusError",
                            "%s", complaint);
    }
    return fmi2Error;
}

static const char setters[] = MODEL_SETTERS;

/* Whether a variable may be set now. */
static int settable(const instance *c, fmi2ValueReference vr)
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
static fmi2Status begin(instance *c, int32_t phase)
{
    if (c->m.phase != phase - 1) {
        return answer(c, "initialization mode is entered once, and left once");
    }
    c->m.phase = phase;
    return answer(c, model_begin(&c->m, c->m.start));
}

static fmi2Status step(instance *c, double time, double size)
{
    const char *refusal = model_refuses(&c->m, time, size);
    return answer(c, refusal != 0 ? refusal : model_step(&c->m, time, size));
}

EXPORT const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

EXPORT const char *fmi2GetVersion(void)
{
    return "2.0";
}

EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n,
                                      const fmi2String categories[])
{
    return fmi2OK;
}

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token,
                                     fmi2String resources, const fmi2CallbackFunctions *functions,
                                     fmi2Boolean visible, fmi2Boolean logging)
{
    instance *c = type == fmi2CoSimulation ? calloc(1, sizeof *c) : 0;
    if (c == 0) {
        return 0;
    }
    if (functions != 0) {
        c->callbacks = *functions;
    }
    if (name != 0) {
        strncpy(c->name, name, sizeof c->name - 1);
    }
    if (token == 0 || strcmp(token, MODEL_TOKEN) != 0) {
        (void)answer(c, "the GUID is not that of this FMU");
        free(c);
        return 0;
    }
    model_defaults(&c->m);
    return c;
}

EXPORT void fmi2FreeInstance(fmi2Component c)
{
    free(c);
}

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance,
                                      fmi2Real start, fmi2Boolean ends, fmi2Real stop)
{
    if (!(start >= -1e17 && start <= 1e17)) {
        return answer(c, "the start must be a finite time");
    }
    ((instance *)c)->m.start = ((instance *)c)->m.real[0] = start;
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    return begin(c, INITIALIZING);
}

EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    return begin(c, STEPPING);
}

EXPORT fmi2Status fmi2Terminate(fmi2Component c)
{
    ((instance *)c)->m.phase = TERMINATED;
    return fmi2OK;
}

EXPORT fmi2Status fmi2Reset(fmi2Component c)
{
    model_defaults(&((instance *)c)->m);
    return fmi2OK;
}

/* Value references of a kind begin at `first`; reals, which begin at 0, stand apart. */
#define ACCESS(Kind, type, field, first, count)                                                  \
    EXPORT fmi2Status fmi2Get##Kind(fmi2Component c, const fmi2ValueReference vr[], size_t n,   \
                                    type value[])                                               \
    {                                                                                           \
        size_t i;                                                                               \
        follow(c);                                                                              \
        for (i = 0; i < n; i++) {                                                               \
            if (vr[i] < (first) || vr[i] >= (first) + (count)) {                                \
                return answer(c, "no such value reference");                                    \
            }                                                                                   \
            value[i] = (type)((instance *)c)->m.field[vr[i] - (first)];                         \
        }                                                                                       \
        return fmi2OK;                                                                          \
    }                                                                                           \
    EXPORT fmi2Status fmi2Set##Kind(fmi2Component c, const fmi2ValueReference vr[], size_t n,   \
                                    const type value[])                                         \
    {                                                                                           \
        size_t i;                                                                               \
        for (i = 0; i < n; i++) {                                                               \
            if (vr[i] < (first) || vr[i] >= (first) + (count)) {                                \
                return answer(c, "no such value reference");                                    \
            }                                                                                   \
            if (!settable(c, vr[i])) {                                                          \
                return answer(c, "this variable cannot be set now");                            \
            }                                                                                   \
            ((instance *)c)->m.field[vr[i] - (first)] = value[i];                               \
        }                                                                                       \
        return fmi2OK;                                                                          \
    }

ACCESS(Integer, fmi2Integer, integer, (unsigned)REALS, (unsigned)INTEGERS)
ACCESS(Boolean, fmi2Boolean, boolean, (unsigned)(REALS + INTEGERS), (unsigned)BOOLEANS)

EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                              fmi2Real value[])
{
    size_t i;
    follow(c);
    for (i = 0; i < n; i++) {
        if (vr[i] >= (unsigned)REALS) {
            return answer(c, "no such value reference");
        }
        value[i] = ((instance *)c)->m.real[vr[i]];
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                              const fmi2Real value[])
{
    size_t i;
    for (i = 0; i < n; i++) {
        if (vr[i] >= (unsigned)REALS) {
            return answer(c, "no such value reference");
        }
        if (!settable(c, vr[i])) {
            return answer(c, "this variable cannot be set now");
        }
        ((instance *)c)->m.real[vr[i]] = value[i];
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                fmi2String value[])
{
    return n > 0 ? answer(c, "there are no strings") : fmi2OK;
}

EXPORT fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                const fmi2String value[])
{
    return n > 0 ? answer(c, "there are no strings") : fmi2OK;
}

EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean keep)
{
    return step(c, time, size);
}

EXPORT fmi2Status fmi2CancelStep(fmi2Component c)
{
    return answer(c, "steps are never pending");
}

/* States are copies of the model. */
EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (*state == 0) {
        *state = malloc(sizeof(model));
    }
    if (*state == 0) {
        return answer(c, "no memory");
    }
    memcpy(*state, &((instance *)c)->m, sizeof(model));
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    memcpy(&((instance *)c)->m, state, sizeof(model));
    return fmi2OK;
}

EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    free(*state);
    *state = 0;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    *size = sizeof(model);
    return fmi2OK;
}

EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[],
                                        size_t size)
{
    if (size < sizeof(model)) {
        return answer(c, "too little room for a state");
    }
    memcpy(bytes, state, sizeof(model));
    return fmi2OK;
}

EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                          fmi2FMUstate *state)
{
    if (size < sizeof(model)) {
        return answer(c, "too few bytes for a state");
    }
    *state = malloc(sizeof(model));
    if (*state == 0) {
        return answer(c, "no memory");
    }
    memcpy(*state, bytes, sizeof(model));
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[],
                                               size_t n, const fmi2ValueReference known[],
                                               size_t m, const fmi2Real seed[], fmi2Real result[])
{
    return answer(c, "there are no directional derivatives");
}

EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[],
                                              size_t n, const fmi2Integer order[],
                                              const fmi2Real value[])
{
    return answer(c, "inputs are held: they have no derivatives");
}

EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[],
                                               size_t n, const fmi2Integer order[],
                                               fmi2Real value[])
{
    return answer(c, "there are no derivatives of outputs");
}

EXPORT fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    return fmi2Discard;
}

EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = ((instance *)c)->m.real[0];
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind,
                                       fmi2Integer *value)
{
    return fmi2Discard;
}

EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind,
                                       fmi2Boolean *value)
{
    if (kind != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = 0;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind,
                                      fmi2String *value)
{
    return fmi2Discard;
}

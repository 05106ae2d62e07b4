/* The functions of FMI 2.0 for co-simulation around an observer in C99. */
#include <stdlib.h>

typedef void *fmi2Component;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean, fmi2Status;
typedef const char *fmi2String;
typedef void *fmi2FMUstate;
typedef char fmi2Byte;
enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error };

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT
#endif
/* A sample that is due within this part of a period is taken. */
#define NEARLY 1e-9

typedef struct {
    NAME_state observer;
    double values[COUNT], before[INPUTS + 1]; /* the inputs as they were up to a sample */
    double t, period;
    long sample;
    int begun;
} unit;

static const double defaults[COUNT] = {DEFAULTS};

/* From the values that are set. */
static fmi2Status begin(unit *one)
{
    one->t = 0;
    one->period = one->values[PERIOD];
    one->sample = 0;
    one->begun = one->period > 0;
    memcpy(one->before, one->values + FIRST_INPUT, INPUTS * sizeof *one->values);
    BEGIN(&one->observer, one->values)
    TELL(&one->observer, one->values)
    return one->begun ? fmi2OK : fmi2Error;
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT fmi2Component fmi2Instantiate(fmi2String name, int type, fmi2String guid, fmi2String resources,
                                     const void *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    unit *one = type == 1 ? calloc(1, sizeof *one) : NULL;
    (void)name, (void)guid, (void)resources, (void)functions, (void)visible, (void)logging;
    if (one)
        memcpy(one->values, defaults, sizeof defaults);
    return one;
}
EXPORT void fmi2FreeInstance(fmi2Component c) { free(c); }
EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[])
{
    return (void)c, (void)on, (void)n, (void)names, fmi2OK;
}
EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                                      fmi2Boolean has_stop, fmi2Real stop)
{
    return (void)c, (void)has_tolerance, (void)tolerance, (void)start, (void)has_stop, (void)stop, fmi2OK;
}
EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return begin(c); }
EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return begin(c); }
EXPORT fmi2Status fmi2Terminate(fmi2Component c) { return (void)c, fmi2OK; }
EXPORT fmi2Status fmi2Reset(fmi2Component c)
{
    unit *one = c;
    memcpy(one->values, defaults, sizeof defaults);
    one->begun = 0;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference at[], size_t n, fmi2Real values[])
{
    unit *one = c;
    size_t k;
    for (k = 0; k < n; k++) {
        if (at[k] >= COUNT)
            return fmi2Error;
        values[k] = one->values[at[k]];
    }
    return fmi2OK;
}
EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference at[], size_t n, const fmi2Real values[])
{
    unit *one = c;
    size_t k;
    for (k = 0; k < n; k++) {
        if (at[k] >= COUNT)
            return fmi2Error;
        one->values[at[k]] = values[k];
    }
    return fmi2OK;
}

/* Samples that are due at the beginning of the step, or in it, read what is set. */
EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean kept)
{
    unit *one = c;
    double left = h, due, step;
    (void)t, (void)kept;
    if (!one->begun || !(h >= 0))
        return fmi2Error;
    for (;;) {
        due = (double)(one->sample + FIRST_SAMPLE) * one->period - one->t;
        if (due <= NEARLY * one->period) {
            CORRECT(&one->observer, one->values + FIRST_OUTPUT, one->before)
            one->sample++;
            continue;
        }
        memcpy(one->before, one->values + FIRST_INPUT, INPUTS * sizeof *one->values);
        if (!(left > 0))
            break;
        step = due < left - NEARLY * one->period ? due : left;
        PREDICT(&one->observer, step, one->values + FIRST_INPUT)
        one->t += step;
        left = step < left ? left - step : 0;
        if (!(left > 0))
            break;
    }
    TELL(&one->observer, one->values)
    return fmi2OK;
}
EXPORT fmi2Status fmi2CancelStep(fmi2Component c) { return (void)c, fmi2Error; }

#define NONE(name, type) \
    EXPORT fmi2Status fmi2Get##name(fmi2Component c, const fmi2ValueReference at[], size_t n, type values[]) \
    { \
        return (void)c, (void)at, (void)values, n ? fmi2Error : fmi2OK; \
    } \
    EXPORT fmi2Status fmi2Set##name(fmi2Component c, const fmi2ValueReference at[], size_t n, const type values[]) \
    { \
        return (void)c, (void)at, (void)values, n ? fmi2Error : fmi2OK; \
    }
NONE(Integer, fmi2Integer)
NONE(Boolean, fmi2Boolean)
NONE(String, fmi2String)

EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (!*state)
        *state = malloc(sizeof(unit));
    if (!*state)
        return fmi2Error;
    memcpy(*state, c, sizeof(unit));
    return fmi2OK;
}
EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    memcpy(c, state, sizeof(unit));
    return fmi2OK;
}
EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}
EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    return (void)c, (void)state, *size = sizeof(unit), fmi2OK;
}
EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (size < sizeof(unit))
        return fmi2Error;
    (void)c;
    memcpy(bytes, state, sizeof(unit));
    return fmi2OK;
}
EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    if (size < sizeof(unit) || (!*state && !(*state = malloc(sizeof(unit)))))
        return fmi2Error;
    (void)c;
    memcpy(*state, bytes, sizeof(unit));
    return fmi2OK;
}
EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference of[], size_t n,
                                               const fmi2ValueReference to[], size_t m, const fmi2Real seed[],
                                               fmi2Real values[])
{
    return (void)c, (void)of, (void)n, (void)to, (void)m, (void)seed, (void)values, fmi2Error;
}
EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference at[], size_t n,
                                              const fmi2Integer order[], const fmi2Real values[])
{
    return (void)c, (void)at, (void)n, (void)order, (void)values, fmi2Error;
}
EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference at[], size_t n,
                                               const fmi2Integer order[], fmi2Real values[])
{
    return (void)c, (void)at, (void)n, (void)order, (void)values, fmi2Error;
}
#define NO_STATUS(name, type) \
    EXPORT fmi2Status fmi2Get##name(fmi2Component c, int kind, type *value) \
    { \
        return (void)c, (void)kind, (void)value, fmi2Discard; \
    }
NO_STATUS(Status, fmi2Status)
NO_STATUS(RealStatus, fmi2Real)
NO_STATUS(IntegerStatus, fmi2Integer)
NO_STATUS(BooleanStatus, fmi2Boolean)
NO_STATUS(StringStatus, fmi2String)

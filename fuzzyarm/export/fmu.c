#include "@name@.h"
@include@
#include <stddef.h>
#include <string.h>

/* The types of FMI 2.0 (fmi2TypesPlatform.h, fmi2FunctionTypes.h), written down here so that no header is needed. */
typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

#if defined(FMI2_FUNCTION_PREFIX)
#define JOINED_(a, b) a##b
#define JOINED(a, b) JOINED_(a, b)
#define NAMED(name) JOINED(FMI2_FUNCTION_PREFIX, name)
#define OPEN
#else
#define NAMED(name) name
#if defined(_WIN32)
#define OPEN __declspec(dllexport)
#else
#define OPEN
#endif
#endif

enum { GIVEN = @given@, SHOWN = @shown@, RESULTS = @results@, NAME = 256 };

static const double period = @period@; /* s, of a control step */

/* What may be set, in the order of its value references: the name, and the ends of its range in its unit. */
static const struct {
    const char *name;
    double low;
    double high;
} range[GIVEN + SHOWN] = {
@ranges@
};

typedef struct {
    @name@_state state;
    double given[GIVEN];
    double result[RESULTS];
    int running;
} Kept; /* what a host may save and restore */

typedef struct {
    Kept now;
    char name[NAME];
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    fmi2ComponentEnvironment environment;
} Instance;

static fmi2Status refused(const Instance *own, fmi2String text)
{
    if (own->logger != NULL) {
        own->logger(own->environment, own->name, fmi2Error, "logStatusError", "%s", text);
    }
    return fmi2Error;
}

/* Whether a number may be set; otherwise its range is logged. */
static int within(const Instance *own, fmi2ValueReference vr, double value)
{
    const int inside = (value >= range[vr].low) && (value <= range[vr].high);
    if ((inside == 0) && (own->logger != NULL)) {
        own->logger(own->environment, own->name, fmi2Error, "logStatusError",
            "%s = %.9g is out of range; allowed: %.9g to %.9g", range[vr].name, value, range[vr].low, range[vr].high);
    }
    return inside;
}

/* What a value reference stands for: what is given, then what of the memory is shown, then the results. */
static double *place(Instance *own, fmi2ValueReference vr)
{
    double *found = NULL;
    if (vr < (fmi2ValueReference)GIVEN) {
        found = &own->now.given[vr];
    } else if (vr < (fmi2ValueReference)(GIVEN + SHOWN)) {
        found = &own->now.state.memory[vr - GIVEN];
    } else if (vr < (fmi2ValueReference)(GIVEN + SHOWN + RESULTS)) {
        found = &own->now.result[vr - GIVEN - SHOWN];
    } else {
        found = NULL;
    }
    return found;
}

static void show(Instance *own)
{
@show@
}

static void begin(Instance *own)
{
    int k;
    @name@_init(&own->now.state);
    for (k = 0; k < GIVEN; k++) {
        own->now.given[k] = 0.0;
    }
    for (k = 0; k < RESULTS; k++) {
        own->now.result[k] = 0.0;
    }
@started@
    show(own);
    own->now.running = 0;
}

OPEN const char *NAMED(fmi2GetTypesPlatform)(void)
{
    return "default";
}

OPEN const char *NAMED(fmi2GetVersion)(void)
{
    return "2.0";
}

OPEN fmi2Component NAMED(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    Instance *own = NULL;
    Instance first;
    (void)resources;
    (void)visible;
    (void)logging;
    if ((functions == NULL) || (functions->allocateMemory == NULL) || (functions->freeMemory == NULL)) {
        return NULL; /* no FMI 2.0 host calls so, and there is nobody to tell */
    }
    memset(&first, 0, sizeof first);
    (void)strncpy(first.name, (name != NULL) ? name : "@name@", (size_t)NAME - 1U); /* the host may reuse its text */
    first.logger = functions->logger;
    first.allocate = functions->allocateMemory;
    first.release = functions->freeMemory;
    first.environment = functions->componentEnvironment;
    if (type != fmi2CoSimulation) {
        (void)refused(&first, "@name@ is an FMI 2.0 FMU for co-simulation: choose co-simulation in the host");
    } else if ((guid == NULL) || (strcmp(guid, "@guid@") != 0)) {
        (void)refused(&first, "the GUID is not that of @name@: the host read the description of another version; "
            "export the FMU again");
    } else {
        own = (Instance *)functions->allocateMemory(1, sizeof first);
        if (own == NULL) {
            (void)refused(&first, "the host has no memory for an instance of @name@");
        } else {
            *own = first;
            begin(own);
        }
    }
    return own;
}

OPEN void NAMED(fmi2FreeInstance)(fmi2Component c)
{
    if (c != NULL) {
        ((Instance *)c)->release(c);
    }
}

OPEN fmi2Status NAMED(fmi2ExitInitializationMode)(fmi2Component c)
{
    show((Instance *)c);
    ((Instance *)c)->now.running = 1;
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2Reset)(fmi2Component c)
{
    begin((Instance *)c);
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2GetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    Instance *own = (Instance *)c;
    size_t k;
    if (own->now.running == 0) {
        show(own);
    }
    for (k = 0; k < nvr; k++) {
        const double *from = place(own, vr[k]);
        if (from == NULL) {
            return refused(own, "fmi2GetReal of a value reference that @name@ does not have");
        }
        value[k] = *from;
    }
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2SetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    Instance *own = (Instance *)c;
    const fmi2ValueReference open = (fmi2ValueReference)((own->now.running != 0) ? GIVEN : (GIVEN + SHOWN));
    size_t k;
    for (k = 0; k < nvr; k++) {
        if (vr[k] >= open) {
            return refused(own, "fmi2SetReal of an output, or of a start value or parameter after the initialization");
        }
        if (within(own, vr[k], value[k]) == 0) {
            return fmi2Error;
        }
        *place(own, vr[k]) = value[k];
    }
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2DoStep)(fmi2Component c, fmi2Real now, fmi2Real size, fmi2Boolean keeps)
{
    Instance *own = (Instance *)c;
    const double count = size / period;
    const long steps = ((count > 0.5) && (count < 1e9)) ? (long)(count + 0.5) : 0;
    const double rest = (((double)steps) * period) - size;
    /* Two instants that the host subtracts are rounded: 2^-51 of a late one is more than a millionth of a period. */
    const double late = ((now < 0.0) ? -now : now) * 4.44e-16;
    const double slack = (late < (0.25 * period)) ? (late + (1e-6 * period)) : (0.25 * period);
    long step;
    (void)keeps;
    if ((steps < 1) || (rest > slack) || (rest < -slack)@single@) {
        return refused(own, "the communication step size of @name@ must be @allowed@");
    }
    for (step = 0; step < steps; step++) {
        if (@name@_step(&own->now.state, own->now.given, own->now.result) != 0) {
            return refused(own, "an output of @name@ is not finite any more");
        }
    }
    return fmi2OK;
}

/* A place for what is saved: the host's own, or a new one. */
static Kept *saved(Instance *own, fmi2FMUstate *state)
{
    if (*state == NULL) {
        *state = own->allocate(1, sizeof(Kept));
        if (*state == NULL) {
            (void)refused(own, "the host has no memory for a state of @name@");
        }
    }
    return (Kept *)*state;
}

OPEN fmi2Status NAMED(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    Kept *to = saved((Instance *)c, state);
    if (to == NULL) {
        return fmi2Error;
    }
    *to = ((Instance *)c)->now;
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state)
{
    if (state == NULL) {
        return refused((Instance *)c, "fmi2SetFMUstate without a state: get one first");
    }
    ((Instance *)c)->now = *(Kept *)state;
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    if (*state != NULL) {
        ((Instance *)c)->release(*state);
        *state = NULL;
    }
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c;
    (void)state;
    *size = sizeof(Kept);
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if ((state == NULL) || (size < sizeof(Kept))) {
        return refused((Instance *)c, "fmi2SerializeFMUstate needs a state, and room for all its bytes");
    }
    (void)memcpy(bytes, state, sizeof(Kept));
    return fmi2OK;
}

OPEN fmi2Status NAMED(fmi2DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    Kept *to;
    if (size != sizeof(Kept)) {
        return refused((Instance *)c, "the bytes are not those of a state of @name@");
    }
    to = saved((Instance *)c, state);
    if (to == NULL) {
        return fmi2Error;
    }
    (void)memcpy(to, bytes, sizeof(Kept));
    return fmi2OK;
}

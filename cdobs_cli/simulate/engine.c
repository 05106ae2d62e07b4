/* The hybrid run, one run after the other: flow, jump, next sample. What stands above this text is generated: the
   sizes, the routines of the loop (flow, measure, jump, control, look, trigger, noise_of), and one step of the method
   (step, dense). The rules are those of engine.py, integrator.py, trigger.py, watch.py and disturbance.py. */

#include <float.h>
#include <stdlib.h>
#include <string.h>

enum { REACHED, TRIGGERED, HALTED, SINGULAR, EXHAUSTED };
/* Why a run ended; LOST + k is reason k of the watch. */
enum { TO_THE_END, NO_STEP, STEPS, SAMPLES, CROWDED, UNREADY, START, LOST };
/* Why the call ended. */
enum { ALL, FULL, DRAWS_WANTED, OUTSIDE };
enum { ON_GRID, BEFORE, AFTER };

#define LAST (HELD - 1)

typedef struct {
    /* What all runs share. */
    double horizon, atol, smallest_share, longest, step_slack;
    long runs, max_steps, max_samples, grid_points, drawn_noise, drawn_disturbance, bounded, white, chooses;
    const double *grid, *low, *high, *factor, *ends;
    /* By run: start, what is held, both before the first jump; the first measurement; the limit of the error. */
    const double *y0, *held0, *before0, *measured0, *limit, *instants, *noise, *disturbance;
    /* Of each reading the outputs that it leaves out; of each sample after the first what it reads. */
    const long *unread, *readings;
    long patterns, instants_each;
    /* What comes out. */
    double *log, *samples;
    long log_rows, sample_rows;
    long *log_from, *samples_from, *code, *steps, *which;
    double *stop_t, *stop_y, *stop_held, *margin, *first, *value, *beyond;
} Batch;

typedef struct {
    const Batch *b;
    long r, steps, due, rows, sampled, index, drawn, left, reason;
    double t, h, next, until, piece, end_of_pieces, stop;
    double y[SIZE], held[HELD], largest[SIZE], floor_[SIZE];
    int outcome;
} Run;

static int all_finite(const double *v, int n)
{
    for (int i = 0; i < n; i++)
        if (!(fabs(v[i]) <= DBL_MAX))
            return 0;
    return 1;
}

/* ---- what is kept ------------------------------------------------------------------------------------- */

static int put(Run *run, double t, int kind, const double *y, const double *held)
{
    const Batch *b = run->b;
    if (run->rows >= b->log_rows) {
        run->outcome = FULL;
        return 0;
    }
    double *place = b->log + run->rows++;
    place[0] = t;
    place[b->log_rows] = kind;
    for (int i = 0; i < SIZE; i++)
        place[(2 + i) * b->log_rows] = y[i];
    for (int i = 0; i < HELD; i++)
        place[(2 + SIZE + i) * b->log_rows] = held[i];
    return 1;
}

static int put_sample(Run *run, double t, const double *measured)
{
    const Batch *b = run->b;
    if (run->sampled >= b->sample_rows) {
        run->outcome = FULL;
        return 0;
    }
    double *place = b->samples + run->sampled++;
    place[0] = t;
    for (int i = 0; i < OUTPUTS; i++)
        place[(1 + i) * b->sample_rows] = measured[i];
    return 1;
}

/* ---- what is looked at -------------------------------------------------------------------------------- */

static double distance(const double *y, const double *seen)
{
    double sum = 0.0;
#if ESTIMATE == 1
    for (int i = 0; i < STATES; i++) {
        double part = seen[X_HAT + i] - y[i];
        sum += part * part;
    }
#elif ESTIMATE == 2
    for (int i = 0; i < STATES; i++) {
        double part = max(fabs(y[i] - seen[X_LOWER + i]), fabs(seen[X_UPPER + i] - y[i]));
        sum += part * part;
    }
#else
    (void)y, (void)seen;
#endif
    return sqrt(sum);
}

static void depart(Run *run, double t, const double *seen)
{
    const Batch *b = run->b;
    double worst = -HUGE_VAL;
    int which = 0;
    for (int k = 0; k < LIMITS; k++) {
        const double *end = b->ends + 3 * k, value = seen[LIMIT + k];
        double beyond = max(end[0] - value, value - end[1]);
        beyond = beyond > end[2] ? beyond : -HUGE_VAL;
        double *most = b->beyond + k * b->runs + run->r;
        if (beyond > *most)
            *most = beyond;
        if (beyond > worst) {
            worst = beyond;
            which = k;
        }
    }
    if (worst > 0 && t < b->first[run->r]) {
        b->first[run->r] = t;
        b->which[run->r] = which;
        b->value[run->r] = seen[LIMIT + which];
    }
}

/* Whether the run goes on past this point. */
static int look_at(Run *run, double t, const double *y, const double *held)
{
    const Batch *b = run->b;
    double seen[SEEN + 1];
    look(t, y, held, seen);
    for (int k = 0; k < RANGES; k++)
        if (!(seen[RANGE + k] >= b->low[k] && seen[RANGE + k] <= b->high[k])) {
            run->outcome = OUTSIDE;
            return 0;
        }
    int finite = all_finite(y, SIZE);
    int near = finite && (!ESTIMATE || distance(y, seen) <= b->limit[run->r]);
    long reason = near ? -1 : 0;
    for (int k = 0; k < STOPS && reason < 0; k++)
        if (!(seen[STOP + k] > 0))
            reason = 1 + k;
    for (int k = 0; k < KEPT && reason < 0; k++)
        if (!(seen[KEEP + k] >= b->low[RANGES + k] && seen[KEEP + k] <= b->high[RANGES + k]))
            reason = 1 + STOPS + k;
    if (finite && LIMITS)
        depart(run, t, seen);
#if ENCLOSES
    if (finite) {
        double inside = HUGE_VAL;
        for (int i = 0; i < STATES; i++)
            inside = min(inside, min(y[i] - seen[X_LOWER + i], seen[X_UPPER + i] - y[i]));
        if (inside != inside)
            inside = -HUGE_VAL;
        if (inside < b->margin[run->r])
            b->margin[run->r] = inside;
    }
#endif
    if (reason < 0)
        return 1;
    run->reason = LOST + reason;
    return 0;
}

/* ---- the flow ----------------------------------------------------------------------------------------- */

static double next_step(double error)
{
    if (!(error < 1e16))
        return 0.2;
    if (error < 1e-6)
        return 6.0;
    double factor = 0.9 * pow(error, -1.0 / 8.0);
    return factor > 6.0 ? 6.0 : factor < 0.2 ? 0.2 : factor;
}

static double first_step(const Run *run, const double *k)
{
    double size = 0.0, rate = 0.0;
    for (int i = 0; i < SIZE; i++) {
        double scale = run->floor_[i] + RTOL * fabs(run->y[i]);
        size = max(size, fabs(run->y[i]) / scale);
        rate = max(rate, fabs(k[i]) / scale);
    }
    double most = 1e-3 * run->b->horizon;
    if (!(fabs(rate) <= DBL_MAX) || rate == 0.0)
        return most;
    if (!(size > 0))
        return 1e-6 * run->b->horizon;
    double tried = 0.01 * size / rate;
    return tried < most ? tried : most;
}

static void interpolate(const double c[7][SIZE], const double *y, double theta, double *out)
{
    for (int i = 0; i < SIZE; i++) {
        double value = 0.0;
        for (int k = 6; k >= 0; k--)
            value = (value + c[k][i]) * (k % 2 == 0 ? theta : 1.0 - theta);
        out[i] = y[i] + value;
    }
}

static double triggered_at(const Run *run, const double c[7][SIZE], double h, double theta)
{
    double y[SIZE], value[2];
    interpolate(c, run->y, theta, y);
    trigger(run->t + theta * h, y, run->held, value);
    return value[0];
}

/* The first theta in (0, 1] with trigger >= 0; 2 where there is none. Regula falsi (Illinois), and bisections. */
static double first_root(const Run *run, const double c[7][SIZE], double h)
{
    double low = 0.0, high = 2.0, below = triggered_at(run, c, h, 0.0), above = NAN;
    for (int quarter = 1; quarter <= 4 && high > 1.0; quarter++) {
        double now = triggered_at(run, c, h, 0.25 * quarter);
        if (now >= 0) {
            high = 0.25 * quarter;
            above = now;
        } else {
            low = 0.25 * quarter;
            below = now;
        }
    }
    if (high > 1.0)
        return high;
    double root = high, least = fabs(above), a = low, b = high, fa = below, fb = above;
    int last_up = -1;
    for (int iteration = 0; iteration < ROOT_ITERATIONS; iteration++) {
        double guess = b - fb * (b - a) / (fb - fa);
        if (!(guess > a && guess < b && iteration % 5 != 4))
            guess = (a + b) / 2;
        double f = triggered_at(run, c, h, guess);
        int better = fabs(f) <= least;
        int done = b - a <= ROOT_FINE || f == 0 || (better && fabs(guess - root) <= ROOT_FINE);
        if (better) {
            root = guess;
            least = fabs(f);
        }
        if (done)
            break;
        int up = f >= 0;
        if (up) {
            fa = last_up == 1 ? fa / 2 : fa;
            b = guess;
            fb = f;
        } else {
            fb = last_up == 0 ? fb / 2 : fb;
            a = guess;
            fa = f;
        }
        last_up = up;
    }
    return root;
}

/* The length of the step that ends at the root, from full steps; the state there goes to `state`. */
static double polished(const Run *run, const double c[7][SIZE], const double *k, double h, double theta, double *state)
{
    double back = theta - 1e-4 > 0 ? theta - 1e-4 : 0.0, slopes[13][SIZE], error, value[2];
    double slope = (triggered_at(run, c, h, theta) - triggered_at(run, c, h, back)) / ((theta - back) * h);
    double s = theta * h;
    memcpy(slopes[0], k, sizeof slopes[0]);
    step(run->t, s, run->y, run->held, run->floor_, slopes, state, &error);
    for (int pass = 0; pass < 2; pass++) {
        trigger(run->t + s, state, run->held, value);
        double change = -value[0] / slope;
        if (!(fabs(change) <= ROOT_FAR * h))
            break;
        s += change;
        if (fabs(change) <= ROOT_NEAR * h)
            for (int i = 0; i < SIZE; i++)
                state[i] += change * slopes[12][i];
        else
            step(run->t, s, run->y, run->held, run->floor_, slopes, state, &error);
    }
    return s;
}

static int on_grid(Run *run, double until, double h, const double c[7][SIZE])
{
    const Batch *b = run->b;
    double y[SIZE];
    for (; run->due < b->grid_points && b->grid[run->due] <= until; run->due++) {
        interpolate(c, run->y, (b->grid[run->due] - run->t) / h, y);
        if (!put(run, b->grid[run->due], ON_GRID, y, run->held))
            return 0;
    }
    return 1;
}

/* Points up to `until` that are those of a state. */
static int at_state(Run *run, double until, const double *y)
{
    const Batch *b = run->b;
    for (; run->due < b->grid_points && b->grid[run->due] <= until; run->due++)
        if (!put(run, b->grid[run->due], ON_GRID, y, run->held))
            return 0;
    return 1;
}

static int advance(Run *run, double end)
{
    const Batch *b = run->b;
    double slopes[13][SIZE], c[7][SIZE], new[SIZE], k[SIZE], error, smallest = 1e-15 * b->horizon, top = 0.0;
    for (int i = 0; i < SIZE; i++) {
        run->largest[i] = max(run->largest[i], fabs(run->y[i]));
        top = max(top, run->largest[i]);
    }
    for (int i = 0; i < SIZE; i++)
        run->floor_[i] = b->atol * max(run->largest[i], b->smallest_share * top) + 1e-300;
    if (!look_at(run, run->t, run->y, run->held))
        return HALTED;
    flow(run->t, run->y, run->held, k);
    if (!all_finite(k, SIZE))
        return SINGULAR;
    if (run->h <= 0)
        run->h = first_step(run, k);
    while (run->t < end) {
        if (run->steps >= b->max_steps)
            return EXHAUSTED;
        double left = end - run->t, h = run->h;
        double tried = h >= left ? left : 2 * h > left ? left / 2 : h;
        memcpy(slopes[0], k, sizeof k);
        step(run->t, tried, run->y, run->held, run->floor_, slopes, new, &error);
        run->steps++;
        if (!(error <= 1.0)) {
            double factor = next_step(error);
            run->h = tried * (factor < 0.9 ? factor : 0.9);
            if (run->h < smallest + 4e-16 * run->t)
                return SINGULAR;
            continue;
        }
        double suggested = tried * next_step(error);
        if (tried < h && h > suggested)
            suggested = h;
        double until = tried == left ? end : run->t + tried;
        int code = REACHED;
        double near = AT_AN_END * tried;
        /* Points at either end of a step need no dense output. */
        if (!at_state(run, run->t + near, run->y))
            return HALTED;
        if (b->chooses || (run->due < b->grid_points && b->grid[run->due] < until - near)) {
            dense(run->t, tried, run->y, run->held, slopes, new, c);
            if (b->chooses) {
                double theta = first_root(run, (const double (*)[SIZE])c, tried);
                if (theta <= 1.0) {
                    until = run->t + polished(run, (const double (*)[SIZE])c, k, tried, theta, new);
                    code = TRIGGERED;
                }
            }
            if (!on_grid(run, until, tried, (const double (*)[SIZE])c))
                return HALTED;
        } else if (!at_state(run, until, new))
            return HALTED;
        run->h = suggested;
        run->t = until;
        memcpy(run->y, new, sizeof new);
        memcpy(k, slopes[12], sizeof k);
        if (!look_at(run, run->t, run->y, run->held))
            return HALTED;
        if (code == TRIGGERED)
            return TRIGGERED;
    }
    return REACHED;
}

/* ---- samples ------------------------------------------------------------------------------------------ */

static const double *drawn(const double *table, const Run *run, long channels, long count)
{
    return table + run->r * channels * count;
}

/* The disturbance from here on: bounded, sample number `index`; white, the next sub-step. */
static int disturb(Run *run, double *d)
{
    const Batch *b = run->b;
    const double *table = drawn(b->disturbance, run, DISTURBED, b->drawn_disturbance);
    long at = b->white ? run->drawn : run->index;
    if (at >= b->drawn_disturbance) {
        run->outcome = DRAWS_WANTED;
        return 0;
    }
    for (int i = 0; i < DISTURBED; i++) {
        if (b->bounded) {
            const double *end = b->factor + 2 * i;
            d[i] = end[0] + (end[1] - end[0]) * table[i * b->drawn_disturbance + at];
            continue;
        }
        double total = 0.0;
        for (int j = 0; j < DISTURBED; j++)
            total += b->factor[i * DISTURBED + j] * table[j * b->drawn_disturbance + at];
        d[i] = total / sqrt(run->piece);
    }
    if (b->white) {
        run->drawn++;
        run->left--;
        run->until = run->left > 0 ? run->t + run->piece : run->end_of_pieces;
    }
    return 1;
}

/* Sub-steps of a white disturbance until the next sample. */
static void divide(Run *run)
{
    const Batch *b = run->b;
    if (!b->white)
        return;
    int known = fabs(run->next) <= DBL_MAX;
    double parts = known ? max(1.0, ceil((run->next - run->t) / b->longest - b->step_slack)) : 9.0e18;
    run->left = known ? (long)parts : 9000000000000000000L;
    run->piece = known ? (run->next - run->t) / parts : b->longest;
    run->end_of_pieces = run->next;
}

static int sample(Run *run)
{
    const Batch *b = run->b;
    double v[OUTPUTS + 1], draw[DRAWS + 1], measured[OUTPUTS + 1], after[SIZE], since[HELD];
    for (int k = 0; k < DRAWS; k++) {
        if (run->index >= b->drawn_noise) {
            run->outcome = DRAWS_WANTED;
            return 0;
        }
        draw[k] = drawn(b->noise, run, DRAWS, b->drawn_noise)[k * b->drawn_noise + run->index];
    }
    noise_of(run->t, draw, v);
    for (int k = 0; k < NOISES; k++)
        if (!(v[k] >= b->low[RANGES + KEPT + k] && v[k] <= b->high[RANGES + KEPT + k])) {
            run->outcome = OUTSIDE;
            return 0;
        }
    measure(run->t, run->y, run->held, v, measured);
    double elapsed = run->t - run->held[LAST];
    long reading = b->patterns ? b->readings[run->r * b->instants_each + run->index - 1] : 0;
    for (int k = 0; k < OUTPUTS && b->patterns; k++)
        if (b->unread[reading * OUTPUTS + k])
            measured[k] = NAN;
    jump(reading, run->t, run->y, run->held, measured, after);
    run->next = b->chooses ? HUGE_VAL : b->instants[run->r * b->instants_each + run->index];
    memcpy(since, run->held, sizeof since);
    for (int k = 0; k < LAST_MEASURED; k++)
        if (measured[k] == measured[k]) /* else not read at this sample */
            since[CONTROLS + k] = measured[k];
    divide(run);
    if (DISTURBED && !disturb(run, since + CONTROLS + LAST_MEASURED))
        return 0;
    since[LAST] = run->t;
    double set[CONTROLS + 1];
    control(run->t, after, since, set);
    memcpy(since, set, CONTROLS * sizeof(double));
    if (!put_sample(run, run->t, measured) || !put(run, run->t, BEFORE, run->y, run->held)
        || !put(run, run->t, AFTER, after, since))
        return 0;
    memcpy(run->y, after, sizeof after);
    memcpy(run->held, since, sizeof since);
    if (!b->chooses)
        return 1;
    double value[2];
    trigger(run->t, run->y, run->held, value);
    run->reason = elapsed < 1e-12 * b->horizon ? CROWDED : value[0] < 0 ? TO_THE_END : UNREADY;
    return run->reason == TO_THE_END;
}

/* From one sample to the next, or the horizon: whether the run goes on. */
static int flow_on(Run *run)
{
    const Batch *b = run->b;
    double last = run->next < b->horizon ? run->next : b->horizon;
    int code;
    for (;;) {
        code = advance(run, run->until < last ? run->until : last);
        if (code == SINGULAR || code == EXHAUSTED)
            run->reason = code == SINGULAR ? NO_STEP : STEPS;
        if (code != REACHED || !(run->t < last))
            break;
        if (!disturb(run, run->held + CONTROLS + LAST_MEASURED))
            return 0;
    }
    if (code != REACHED && code != TRIGGERED)
        return 0;
    if (code == TRIGGERED || run->t >= run->next) {
        run->index++;
        if (run->index >= b->max_samples) {
            run->reason = SAMPLES;
            return 0;
        }
        return sample(run);
    }
    return 1;
}

static void begin(Run *run, const Batch *b, long r, long rows, long sampled)
{
    memset(run, 0, sizeof *run);
    run->b = b;
    run->r = r;
    run->rows = rows;
    run->sampled = sampled;
    run->until = HUGE_VAL;
    memcpy(run->y, b->y0 + r * SIZE, sizeof run->y);
    memcpy(run->held, b->held0 + r * HELD, sizeof run->held);
    run->next = b->chooses ? HUGE_VAL : b->instants[r * b->instants_each];
    divide(run);
    run->index = 0;
    b->margin[r] = b->first[r] = HUGE_VAL;
    for (int k = 0; k < LIMITS; k++)
        b->beyond[k * b->runs + r] = -HUGE_VAL;
}

/* All runs from `first_run` on, until the room for what is kept is full; `*done` is the first run that is not done. */
int run_batch(const Batch *b, long first_run, long *done)
{
    long rows = 0, sampled = 0;
    for (long r = first_run; r < b->runs; r++) {
        Run run;
        double d[DISTURBED + 1];
        begin(&run, b, r, rows, sampled);
        const double *before = b->before0 + r * (SIZE + HELD);
        int going = put_sample(&run, 0.0, b->measured0 + r * OUTPUTS) && put(&run, 0.0, BEFORE, before, before + SIZE)
            && put(&run, 0.0, AFTER, run.y, run.held) && (!DISTURBED || disturb(&run, d));
        if (b->code[r] != TO_THE_END) { /* halted at the start */
            going = 0;
            run.reason = b->code[r];
        }
        while (going && run.t < b->horizon)
            going = flow_on(&run);
        /* A jump at the horizon is followed by no flow that would look at it. */
        if (going)
            look_at(&run, run.t, run.y, run.held);
        *done = r;
        if (run.outcome)
            return run.outcome;
        b->code[r] = run.reason;
        b->steps[r] = run.steps;
        b->stop_t[r] = run.t;
        memcpy(b->stop_y + r * SIZE, run.y, sizeof run.y);
        memcpy(b->stop_held + r * HELD, run.held, sizeof run.held);
        rows = run.rows;
        sampled = run.sampled;
        b->log_from[r + 1] = rows;
        b->samples_from[r + 1] = sampled;
    }
    *done = -1;
    return ALL;
}

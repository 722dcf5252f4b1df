/* Exact simulation of independent Hawkes processes with exponential kernels (2.2), merged in the order of time.
 *
 * The time to a timeline's next event is the smaller of two (Dassios and Zhao 2013): that of a Poisson process of
 * rate mu, and that of one whose rate begins at the excess Y = lambda - mu and decays, both by inversion of an
 * exponential variate. A timeline's clock changes only at its own events, so a heap of next times merges all. */
#include <math.h>
#include <stdint.h>

static inline int before(double time, int32_t pair, double other_time, int32_t other_pair) {
  return time < other_time || (time == other_time && pair < other_pair);
}

/* Let time[0 ...] and pair[0 ...] be the next events, until `wanted`, or `end` is passed; two of `draw`, standard
 * exponential variates, go into each. when, who: heap of the timelines' next events; excess: Y just before them, kept
 * from call to call. Returns through `made` the number of events. */
void extremal_simulate(int64_t pairs, const double *mu, const double *jump, const double *omega, double end,
                       int64_t wanted, const double *draw, double *when, int32_t *who, double *excess, double *time,
                       int32_t *pair, int64_t *made) {
  int64_t n = 0;
  for (; n < wanted && when[0] <= end && when[0] < INFINITY; ++n) {
    const int32_t i = who[0];
    const double now = when[0], y = excess[i] + jump[i];
    time[n] = now;
    pair[n] = i;

    const double used = omega[i] * draw[2 * n], left = y - used; /* Y once its own process has brought the event */
    double wait = left > 0 ? -log1p(-used / y) / omega[i] : INFINITY;
    const double background = mu[i] > 0 ? draw[2 * n + 1] / mu[i] : INFINITY;
    if (background < wait) {
      wait = background;
      excess[i] = y * exp(-omega[i] * wait);
    } else {
      excess[i] = wait < INFINITY ? left : 0;
    }

    const double next = now + wait;
    int64_t hole = 0;
    for (;;) {
      int64_t child = 2 * hole + 1;
      if (child >= pairs) break;
      if (child + 1 < pairs && before(when[child + 1], who[child + 1], when[child], who[child])) ++child;
      if (!before(when[child], who[child], next, i)) break;
      when[hole] = when[child];
      who[hole] = who[child];
      hole = child;
    }
    when[hole] = next;
    who[hole] = i;
  }
  *made = n;
}

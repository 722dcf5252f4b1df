/* Mean field: the score of each slot from the probabilities of all others. Slots as in kernel.c. */
#include <math.h>
#include <stdint.h>

static inline double quiet(double x) { return x < 1e-300 ? 0 : x; } /* denormal numbers are slow */

/* The f that is a e + b e^2 and has f(1) = one, f(1/2) = half. */
static inline void parabola(double one, double half, double *a, double *b) {
  *a = 4 * half - one;
  *b = 2 * one - 4 * half;
}

/* score[s] = ln lambda + sum over later slots l of the timeline of q_l ln(1 + k / (lambda_l - q_s k)) - cost, with
 * k = theta omega e, e = exp(-omega dt). With x = k / lambda_l the logarithm is, to first order in q_s,
 * ln(1 + x) + q_s x^2 / (1 + x); both terms are interpolated in e by a e + b e^2, so that recursions with e and e^2 do
 * for all. sums: 4 for each timeline, zero at the start; score[s] holds cost before. */
void extremal_scores(int64_t slots, const int32_t *pair, const double *decay, const double *mu, const double *coupling,
                     const double *q, double (*sums)[4], double *rate, double *score) {
  for (int64_t s = 0; s < slots; ++s) {
    const int32_t i = pair[s];
    const double past = quiet(sums[i][0] * decay[s]);
    rate[s] = mu[i] + coupling[i] * past;
    sums[i][0] = past + q[s];
  }
  for (int64_t s = 0; s < slots; ++s) sums[pair[s]][0] = 0;
  for (int64_t s = slots - 1; s >= 0; --s) {
    const int32_t i = pair[s];
    const double e = decay[s], x = fmin(coupling[i] / rate[s], 1e150), y = 0.5 * x;
    double a, b, c, d, *to = sums[i];
    score[s] = log(rate[s]) + to[0] + to[1] + q[s] * (to[2] + to[3]) - score[s];
    parabola(log1p(x), log1p(y), &a, &b);
    parabola(x * (x / (1 + x)), y * (y / (1 + y)), &c, &d);
    to[0] = quiet(to[0] + q[s] * a) * e;
    to[1] = (to[1] + q[s] * b) * e * e;
    to[2] = quiet(to[2] + q[s] * c) * e;
    to[3] = quiet(to[3] + q[s] * d) * e * e;
  }
}

/* out[j]: largest score of the event's slots, -infinity if there are none here */
void extremal_largest(int64_t events, const int64_t *start, const double *score, double *out) {
  for (int64_t j = 0; j < events; ++j) {
    out[j] = -INFINITY;
    for (int64_t s = start[j]; s < start[j + 1]; ++s) out[j] = fmax(out[j], score[s]);
  }
}

/* score becomes exp(score - largest of the event), total[j] its sum here */
void extremal_exponentials(int64_t events, const int64_t *start, const double *largest, double *score,
                           double *total) {
  for (int64_t j = 0; j < events; ++j) {
    total[j] = 0;
    for (int64_t s = start[j]; s < start[j + 1]; ++s) total[j] += score[s] = exp(score[s] - largest[j]);
  }
}

/* q moves by `step` of the way to value / total */
void extremal_approach(int64_t events, const int64_t *start, const double *value, const double *total, double step,
                       double *q) {
  for (int64_t j = 0; j < events; ++j)
    for (int64_t s = start[j]; s < start[j + 1]; ++s) q[s] += step * (value[s] / total[j] - q[s]);
}

/* The likelihood (3.1) of events on timelines, with compensator, and what maximising it needs: one pass, O(events).
 *
 * Events stand in the order of time; one at the same time as another counts as later if it stands later, the limit
 * of ever smaller intervals. Each has a weight, 1 where it is certain. */
#include <math.h>
#include <stdint.h>

enum { WEIGHT, LOGARITHM, BACKGROUND, TRIGGERED, DELAY, LOST, LATE, LATER, PRODUCTS, MIXED = 14, CURVED, COLUMNS };

/* Sums over the events of each timeline, out[pairs][COLUMNS], in the order of the names above:
 * w, w ln(lambda), w mu/lambda, w p and w p delay (p: share of lambda that earlier events trigger; its mean delay),
 * w (1 - exp(-omega tau)), w tau exp(-omega tau), w tau^2 exp(-omega tau) with tau = T - t;
 * w l_a l_b / lambda^2 for ab = 00 01 02 11 12 22, l the gradient of lambda in (mu, theta, omega);
 * w lambda_12 / lambda, w lambda_22 / lambda. last: -infinity, and moments: 0, at the start, for each timeline. */
void extremal_statistics(int64_t events, const double *time, const int32_t *pair, const double *weight,
                         const double *mu, const double *theta, const double *omega, double end, double *last,
                         double (*moments)[3], double (*out)[COLUMNS]) {
  for (int64_t e = 0; e < events; ++e) {
    const int32_t i = pair[e];
    const double w = weight[e], t = time[e], rate = omega[i], dt = t - last[i];
    double *f = moments[i], *to = out[i];
    if (dt < INFINITY) { /* f: sums of w dt^k exp(-omega dt) over earlier events, k = 0, 1, 2 */
      const double keep = exp(-rate * dt);
      f[2] = keep * (f[2] + dt * (2 * f[1] + dt * f[0]));
      f[1] = keep * (f[1] + dt * f[0]);
      f[0] *= keep;
    }
    const double excited = theta[i] * rate * f[0], lambda = mu[i] + excited;
    const double share = lambda > 0 ? w / lambda : 0;
    const double slope = f[0] - rate * f[1]; /* of omega f0 */
    const double l[3] = {1, rate * f[0], theta[i] * slope};
    const double tau = end - t, left = exp(-rate * tau);
    to[WEIGHT] += w;
    to[LOGARITHM] += w > 0 ? w * log(lambda) : 0;
    to[BACKGROUND] += share * mu[i];
    to[TRIGGERED] += share * excited;
    to[DELAY] += share * theta[i] * rate * f[1];
    to[LOST] -= w * expm1(-rate * tau);
    to[LATE] += w * tau * left;
    to[LATER] += w * tau * tau * left;
    int column = PRODUCTS;
    for (int a = 0; a < 3; ++a)
      for (int b = a; b < 3; ++b) to[column++] += share * l[a] * (lambda > 0 ? l[b] / lambda : 0);
    to[MIXED] += share * slope;
    to[CURVED] += share * theta[i] * (rate * f[2] - 2 * f[1]);
    f[0] += w;
    last[i] = t;
  }
}

/* Gibbs sampling of who took part: each incomplete event in turn moves to a pair drawn from its exact conditional
 * distribution, given where all others are.
 *
 * Each timeline's events are a list in the order of time: head[i], next[e], `events` at its end. As events are visited
 * in that order, the sum of exp(-omega dt) over a timeline's earlier events is carried along, never subtracted from. */
#include <math.h>
#include <stdint.h>

/* ln of what event e changes in the likelihood where it is put on timeline i: lambda at e, and what it adds to lambda
 * at later events, (lambda + k) / lambda each, until k is lost in rounding; less the compensator. */
static double gain(int64_t events, const double *time, const int64_t *next, int64_t e, int64_t l, double past,
                   double mu, double theta, double omega, double end) {
  const double coupling = theta * omega;
  double product = mu + coupling * past, logarithm = theta * expm1(omega * (time[e] - end));
  double own = 1, t = time[e];
  for (; l < events; l = next[l]) {
    const double keep = exp(omega * (t - time[l]));
    past *= keep;
    own *= keep;
    const double lambda = mu + coupling * past, k = coupling * own;
    if (k < 1e-17 * lambda && k < 1e-17 * mu) break;
    product *= 1 + fmin(k / lambda, 1e200);
    if (product > 1e100) {
      logarithm += log(product);
      product = 1;
    }
    past += 1;
    t = time[l];
  }
  return logarithm + log(product);
}

/* One sweep over all events. pair[e]: timeline of each event, -1 for one that no timeline could explain, or, if
 * `fresh`, incomplete ones that have not been put anywhere yet. slot[e]: the event's number among those with slots,
 * -1 otherwise; complete ones have none or one slot. uniform: a random number for each event with slots; the
 * conditional probabilities are those to the `power`, 1 unless in a hurry to leave the starting point; mean: gets the
 * conditional probabilities added. past, last: what is carried along, an entry for each timeline; head, next: the
 * lists; value: room for the largest number of candidates. */
void extremal_gibbs(int64_t events, const double *time, const int32_t *slot, const int64_t *start,
                    const int32_t *candidate, int64_t pairs, const double *mu, const double *theta,
                    const double *omega, double end, const double *uniform, double power, int64_t fresh, int32_t *pair,
                    double *past, int64_t *last, int64_t *head, int64_t *next, double *value, double *mean) {
  for (int64_t i = 0; i < pairs; ++i) {
    past[i] = 0;
    last[i] = -1;
    head[i] = events;
  }
  for (int64_t e = events - 1; e >= 0; --e) {
    const int32_t i = pair[e];
    if (i < 0) continue;
    next[e] = head[i];
    head[i] = e;
  }
  for (int64_t e = 0; e < events; ++e) {
    const int32_t j = slot[e];
    int32_t i = pair[e];
    if (j >= 0 && start[j + 1] - start[j] == 1) mean[start[j]] += 1;
    if (j >= 0 && start[j + 1] - start[j] > 1) {
      if (!fresh) { /* out of its list: it comes right after the last event of its timeline */
        if (last[i] < 0)
          head[i] = next[e];
        else
          next[last[i]] = next[e];
      }
      const int64_t count = start[j + 1] - start[j];
      const int32_t *choice = candidate + start[j];
      double top = -INFINITY, total = 0;
      for (int64_t c = 0; c < count; ++c) {
        const int32_t k = choice[c];
        const int64_t before = last[k];
        const double sum = before < 0 ? 0 : past[k] * exp(omega[k] * (time[before] - time[e]));
        value[c] = gain(events, time, next, e, before < 0 ? head[k] : next[before], sum, mu[k], theta[k], omega[k],
                        end);
        top = fmax(top, value[c]);
      }
      for (int64_t c = 0; c < count; ++c) total += value[c] = exp(power * (value[c] - top));
      double left = uniform[j] * total;
      i = -1;
      for (int64_t c = 0; c < count; ++c) {
        mean[start[j] + c] += value[c] / total;
        if (value[c] > 0 && left >= 0) i = choice[c];
        left -= value[c];
      }
      pair[e] = i;
      next[e] = last[i] < 0 ? head[i] : next[last[i]];
      if (last[i] < 0)
        head[i] = e;
      else
        next[last[i]] = e;
    }
    if (i < 0) continue;
    past[i] = 1 + (last[i] < 0 ? 0 : past[i] * exp(omega[i] * (time[last[i]] - time[e])));
    last[i] = e;
  }
}

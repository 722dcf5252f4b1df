/* The loops of the material point method over particles by cell (chapter 7.3.1).
 *
 * Before this file stand D (2 or 3), N (4 cubic, 3 quadratic) and SINGLE (0 or 1), the precision of the implicit
 * operator; all else is double: then SINGLE is 0. Node arrays are [nodes][D], to be zero where they are added to. Cell
 * c holds the particles order[start[c]] ... order[start[c + 1] - 1]. */
#if SINGLE
#define REAL float
#else
#define REAL double
#endif
#define ROWS (D == 3 ? N * N : N)
#define SYMS (D * (D + 1) / 2)

#include "splines.h"
#include "grid.h"
#include "snow.h"
#include "transfer.h"
#if !SINGLE
#include "flow.h"
#endif

#define EACH_CELL for (int64_t c = 0; c < cells; ++c)
/* up to LANES particles of the cell at a time */
#define EACH_BATCH                                                                 \
  for (int32_t first = start[c], count; first < start[c + 1]; first += count)      \
    if ((count = start[c + 1] - first < LANES ? start[c + 1] - first : LANES) > 0)

static inline void splines_at(int count, const int32_t *some, const double *x, double inverse_h, Spline *splines) {
  for (int l = 0; l < count; ++l) spline_at(x + D * (int64_t)some[l], inverse_h, splines + l);
}

/* width numbers of each of the particles; those of the last one where there are fewer than LANES */
static inline void load(int count, const int32_t *some, int width, const double *from, Lanes *to) {
  REAL *entry = (REAL *)to;
  for (int l = 0; l < LANES; ++l) {
    const double *one = from + width * (int64_t)some[l < count ? l : count - 1];
    for (int k = 0; k < width; ++k) entry[LANES * k + l] = (REAL)one[k];
  }
}

static inline void store(int count, const int32_t *some, int width, const Lanes *from, double *to) {
  for (int l = 0; l < count; ++l)
    for (int k = 0; k < width; ++k) to[width * (int64_t)some[l] + k] = ((const REAL *)from)[LANES * k + l];
}

/* m_i = sum m_p w_ip and m_i v_i = sum m_p v_p w_ip (step 1) */
void extremal_to_grid(int64_t cells, const int32_t *start, const int32_t *order, const int32_t *rows, double h,
                      const double *x, const double *velocity, const double *mass, REAL *node_mass, REAL *momentum) {
  EACH_CELL {
    Block block[D + 1];
    memset(block, 0, sizeof(block));
    EACH_BATCH {
      Spline splines[LANES];
      splines_at(count, order + first, x, 1 / h, splines);
      EACH_GROUP {
        Vector sum[D + 1][MIDDLE];
        for (int b = 0; b <= D; ++b) EACH_MIDDLE sum[b][j] = block[b].middle[j].part[g];
        for (int l = 0; l < count; ++l) {
          const Spline *s = splines + l;
          const int64_t p = order[first + l];
          const Vector here = (REAL)mass[p] * s->here.part[g];
          for (int b = 0; b <= D; ++b) {
            const Vector moved = b < D ? (REAL)velocity[D * p + b] * here : here;
            if (D == 2) sum[b][0] += moved;
            else EACH_MIDDLE sum[b][j] += s->w[j] * moved;
          }
        }
        for (int b = 0; b <= D; ++b) EACH_MIDDLE block[b].middle[j].part[g] = sum[b][j];
      }
    }
    scatter(block, rows + ROWS * c, momentum);
    scatter_scalar(block + D, rows + ROWS * c, node_mass);
  }
}

/* rho_p = sum m_i w_ip / h^D (step 2) */
void extremal_density(int64_t cells, const int32_t *start, const int32_t *order, const int32_t *rows, double h,
                      const double *x, const double *node_mass, double *density) {
  const double volume = D == 3 ? h * h * h : h * h;
  EACH_CELL EACH_BATCH for (int l = 0; l < count; ++l) {
    Spline s;
    double sum = 0;
    spline_at(x + D * (int64_t)order[first + l], 1 / h, &s);
    for (int i = 0; i < N; ++i) EACH_MIDDLE
      for (int k = 0; k < N; ++k)
        sum += (D == 3 ? s.w[j] : 1) * s.here.row[i][k] * node_mass[rows[ROWS * c + MIDDLE * i + j] + k];
    density[order[first + l]] = sum / volume;
  }
}

/* f_i -= sum V_p (P F^T) grad w_ip (7.6) */
void extremal_force(int64_t cells, const int32_t *start, const int32_t *order, const int32_t *rows, double h,
                    const double *x, const double *stretch, const double *moduli, REAL *force) {
  EACH_CELL {
    Block block[D];
    memset(block, 0, sizeof(block));
    EACH_BATCH {
      Spline splines[LANES];
      Lanes w[SYMS], m[MODULI], t[D * D];
      load(count, order + first, SYMS, stretch, w);
      load(count, order + first, MODULI, moduli, m);
      splines_at(count, order + first, x, 1 / h, splines);
      kirchhoff(m, w, t);
      for (int e = 0; e < D * D; ++e) t[e] = -t[e];
      add_forces(count, splines, t, block);
    }
    scatter(block, rows + ROWS * c, force);
  }
}

/* out_i += scale sum V_p (C : G F) F^T grad w_ip with G = sum u_j (grad w_jp)^T (7.7), (7.8) */
void extremal_hessian(int64_t cells, const int32_t *start, const int32_t *order, const int32_t *rows, double h,
                      const double *x, const double *stretch, const double *moduli, double scale, const REAL *u,
                      REAL *out) {
  EACH_CELL {
    Block from[D], block[D];
    memset(block, 0, sizeof(block));
    gather(u, rows + ROWS * c, from);
    EACH_BATCH {
      Spline splines[LANES];
      Lanes w[SYMS], m[MODULI], g[D * D], y[D * D];
      load(count, order + first, SYMS, stretch, w);
      load(count, order + first, MODULI, moduli, m);
      splines_at(count, order + first, x, 1 / h, splines);
      gradients(count, splines, from, g);
      linearised(m, w, g, y);
      for (int e = 0; e < D * D; ++e) y[e] *= (REAL)scale;
      add_forces(count, splines, y, block);
    }
    scatter(block, rows + ROWS * c, out);
  }
}

/* grad v_p; v_p = (1 - flip) sum v_i w_ip + flip (v_p + sum (v_i - v_i^n) w_ip) (steps 7 and 8), apart from `old`.
 * extremes: the largest of -det(1 + dt grad v), |dt grad v| and |v|, by entries; nan where a velocity is not finite. */
void extremal_to_particles(int64_t cells, const int32_t *start, const int32_t *order, const int32_t *rows, double h,
                           const double *x, const REAL *node_new, const REAL *node_old, double flip, double dt,
                           const double *old, double *velocity, double *grad, double *extremes) {
  const Lanes none = {0};
  Lanes squeeze = none - INFINITY, turn = none, speed = none, taint = none;
  EACH_CELL {
    Block now[D], mixed[D];
    gather(node_new, rows + ROWS * c, now);
    gather(node_old, rows + ROWS * c, mixed);
    for (int d = 0; d < D; ++d) EACH_MIDDLE EACH_GROUP
      mixed[d].middle[j].part[g] = now[d].middle[j].part[g] - (REAL)flip * mixed[d].middle[j].part[g];
    EACH_BATCH {
      Spline splines[LANES];
      Lanes g[D * D], v[D], before[D];
      load(count, order + first, D, old, before);
      splines_at(count, order + first, x, 1 / h, splines);
      gradients(count, splines, now, g);
      values(count, splines, mixed, v);
      EACH_COMPONENT v[c] += (REAL)flip * before[c];
      store(count, order + first, D * D, g, grad);
      store(count, order + first, D, v, velocity);
      for (int e = 0; e < D * D; ++e) g[e] *= (REAL)dt;
      squeeze = larger(squeeze, -change_of_volume(g));
      for (int e = 0; e < D * D; ++e) turn = larger(turn, larger(g[e], -g[e]));
      EACH_COMPONENT {
        speed = larger(speed, larger(v[c], -v[c]));
        taint += 0 * v[c];
      }
    }
  }
  for (int e = 0; e < 3; ++e) extremes[e] = -INFINITY;
  for (int l = 0; l < LANES; ++l) {
    const double mine[3] = {squeeze[l], turn[l], speed[l]};
    for (int e = 0; e < 3; ++e) extremes[e] = fmax(extremes[e], mine[e]);
  }
  for (int l = 0; l < LANES; ++l)
    for (int e = 0; e < 3; ++e) extremes[e] += taint[l];
}

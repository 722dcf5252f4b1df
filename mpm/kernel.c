/* The loops of the material point method over particles sorted by cell (chapter 7.3.1).
 *
 * Before this file stand D (2 or 3), N (4 cubic, 3 quadratic) and REAL, the precision of the implicit operator; all
 * else is double: then REAL is double too. Node arrays are [nodes][D], to be zero where they are added to. */
#define ROWS (D == 3 ? N * N : N)
#define SYMS (D * (D + 1) / 2)

#include "splines.h"
#include "grid.h"
#include "snow.h"
#include "transfer.h"
#include "flow.h"

#define EACH_CELL for (int64_t c = 0; c < cells; ++c)
#define EACH_PARTICLE for (int64_t p = start[c]; p < start[c + 1]; ++p)

/* m_i = sum m_p w_ip and m_i v_i = sum m_p v_p w_ip (step 1) */
void extremal_to_grid(int64_t cells, const int32_t *start, const int32_t *rows, double h, const double *x,
                      const double *velocity, const double *mass, REAL *node_mass, REAL *momentum) {
  const double inverse = 1 / h;
  EACH_CELL {
    Row block[ROWS];
    REAL masses[ROWS][N] = {{0}};
    clear(block);
    EACH_PARTICLE {
      Spline s;
      Row q;
      REAL qm[N];
      q.part[PARTS - 1] = (Vector){0};
      spline_at(x + D * p, inverse, &s);
      for (int k = 0; k < N; ++k) {
        qm[k] = s.w[k] * (REAL)mass[p];
        for (int d = 0; d < D; ++d) q.at[D * k + d] = qm[k] * (REAL)velocity[D * p + d];
      }
      for (int r = 0; r < ROWS; ++r) {
        const REAL w = s.row[r];
        for (int k = 0; k < N; ++k) masses[r][k] += w * qm[k];
        EACH_PART block[r].part[v] += w * q.part[v];
      }
    }
    const int32_t *row = rows + ROWS * c;
    scatter(block, row, momentum);
    for (int r = 0; r < ROWS; ++r)
      for (int k = 0; k < N; ++k) node_mass[row[r] + k] += masses[r][k];
  }
}

/* rho_p = sum m_i w_ip / h^D (step 2) */
void extremal_density(int64_t cells, const int32_t *start, const int32_t *rows, double h, const double *x,
                      const double *node_mass, double *density) {
  const double inverse = 1 / h;
  double volume = h * h;
  if (D == 3) volume *= h;
  EACH_CELL EACH_PARTICLE {
    Spline s;
    double sum = 0;
    spline_at(x + D * p, inverse, &s);
    for (int r = 0; r < ROWS; ++r)
      for (int k = 0; k < N; ++k)
        sum += s.row[r] * s.w[k] * node_mass[rows[ROWS * c + r] + k];
    density[p] = sum / volume;
  }
}

/* f_i -= sum V_p (P F^T) grad w_ip (7.6) */
void extremal_force(int64_t cells, const int32_t *start, const int32_t *rows, double h, const double *x,
                    const double *stretch, const double *plastic, const double *volume, const double *stiffness,
                    const int32_t *body, const Law *laws, REAL *force) {
  const double inverse = 1 / h;
  EACH_CELL {
    Row block[ROWS];
    clear(block);
    EACH_PARTICLE {
      const Law *law = laws + body[p];
      const double scale = stiffness[p] * hard(law, plastic[p]) * -volume[p];
      Spline s;
      REAL w[SYMS], t[SYMS], full[D * D];
      for (int k = 0; k < SYMS; ++k) w[k] = (REAL)stretch[SYMS * p + k];
      kirchhoff(law->energy, (REAL)(law->mu * scale), (REAL)(law->lambda * scale), w, t);
      for (int i = 0; i < D; ++i)
        for (int j = 0; j < D; ++j) full[D * i + j] = t[SYM[i][j]];
      spline_at(x + D * p, inverse, &s);
      add_force(&s, full, block);
    }
    scatter(block, rows + ROWS * c, force);
  }
}

/* out_i += scale sum V_p (C : G F) F^T grad w_ip with G = sum u_j (grad w_jp)^T (7.7), (7.8) */
void extremal_hessian(int64_t cells, const int32_t *start, const int32_t *rows, double h, const double *x,
                      const double *stretch, const double *plastic, const double *volume, const double *stiffness,
                      const int32_t *body, const Law *laws, double scale, const REAL *u, REAL *out) {
  const double inverse = 1 / h;
  EACH_CELL {
    const int32_t *row = rows + ROWS * c;
    Row from[ROWS], block[ROWS];
    clear(block);
    gather(u, row, from);
    EACH_PARTICLE {
      const Law *law = laws + body[p];
      const double factor = scale * stiffness[p] * hard(law, plastic[p]) * volume[p];
      Spline s;
      REAL w[SYMS], g[D * D], y[D * D];
      for (int k = 0; k < SYMS; ++k) w[k] = (REAL)stretch[SYMS * p + k];
      spline_at(x + D * p, inverse, &s);
      gradient(&s, from, g);
      linearised(law->energy, (REAL)(law->mu * factor), (REAL)(law->lambda * factor), w, g, y);
      add_force(&s, y, block);
    }
    scatter(block, row, out);
  }
}

/* diagonal[i][a] += scale sum V_p (the (i a, i a) entry of the Hessian), for a Jacobi preconditioner: isotropic
 * estimate with the moduli of small strain, exact at W = I */
void extremal_diagonal(int64_t cells, const int32_t *start, const int32_t *rows, double h, const double *x,
                       const double *plastic, const double *volume, const double *stiffness, const int32_t *body,
                       const Law *laws, double scale, REAL *diagonal) {
  const double inverse = 1 / h;
  EACH_CELL {
    Row block[ROWS];
    clear(block);
    EACH_PARTICLE {
      const Law *law = laws + body[p];
      const double factor = scale * stiffness[p] * hard(law, plastic[p]) * volume[p];
      const double mu = law->mu * factor, dilation = (law->mu + law->lambda) * factor;
      Spline s;
      spline_at(x + D * p, inverse, &s);
      for (int r = 0; r < ROWS; ++r)
        for (int k = 0; k < N; ++k) {
          double g[3] = {s.slope0[r] * s.w[k], 0, 0}, all = 0;
          if (D == 3) g[1] = s.slope1[r] * s.w[k];
          g[D - 1] = s.row[r] * s.dw[k];
          for (int d = 0; d < D; ++d) all += g[d] * g[d];
          for (int d = 0; d < D; ++d) block[r].at[D * k + d] += (REAL)(mu * all + dilation * g[d] * g[d]);
        }
    }
    scatter(block, rows + ROWS * c, diagonal);
  }
}

/* grad v_p; v_p = (1 - flip) sum v_i w_ip + flip (v_p + sum (v_i - v_i^n) w_ip) (steps 7 and 8) */
void extremal_to_particles(int64_t cells, const int32_t *start, const int32_t *rows, double h, const double *x,
                           const REAL *node_new, const REAL *node_old, double flip, double *velocity, double *grad) {
  const double inverse = 1 / h;
  EACH_CELL {
    const int32_t *row = rows + ROWS * c;
    Row now[ROWS], mixed[ROWS];
    gather(node_new, row, now);
    gather(node_old, row, mixed);
    EACH_ROW EACH_PART mixed[r].part[v] = now[r].part[v] - (REAL)flip * mixed[r].part[v];
    EACH_PARTICLE {
      Spline s;
      REAL g[D * D];
      Row sum;
      EACH_PART sum.part[v] = (Vector){0};
      spline_at(x + D * p, inverse, &s);
      gradient(&s, now, g);
      for (int e = 0; e < D * D; ++e) grad[D * D * p + e] = g[e];
      for (int r = 0; r < ROWS; ++r) {
        const REAL w = s.row[r];
        EACH_PART sum.part[v] += w * mixed[r].part[v];
      }
      for (int d = 0; d < D; ++d) {
        REAL total = 0;
        for (int k = 0; k < N; ++k) total += s.w[k] * sum.at[D * k + d];
        velocity[D * p + d] = flip * velocity[D * p + d] + total;
      }
    }
  }
}

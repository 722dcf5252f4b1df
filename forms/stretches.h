/* Singular values of W matrices at a time: F = U diag(s) V^T with U, V rotations, s1 >= s2 >= |s3|, the last one
 * carries the sign of det F. */
#include <math.h>

#if D == 3
#define LANES for (int l = 0; l < W; ++l)

static void rotate(double B[3][3][W], double V[3][3][W], int i, int j, double *off) {
  double cs[W], sn[W];
  LANES {
    const double a = B[i][0][l] * B[i][0][l] + B[i][1][l] * B[i][1][l] + B[i][2][l] * B[i][2][l];
    const double b = B[j][0][l] * B[j][0][l] + B[j][1][l] * B[j][1][l] + B[j][2][l] * B[j][2][l];
    const double c = B[i][0][l] * B[j][0][l] + B[i][1][l] * B[j][1][l] + B[i][2][l] * B[j][2][l];
    const double half = 0.5 * (b - a), root = sqrt(half * half + c * c);
    const double t = c / ((half < 0 ? half - root : half + root) + (root == 0 ? 1 : 0));
    const double relative = c * c - 1e-31 * a * b, cosine = 1 / sqrt(1 + t * t);
    /* a lane that is done stays as it is: its result must not depend on the others in the pack */
    cs[l] = relative > 0 ? cosine : 1;
    sn[l] = relative > 0 ? cosine * t : 0;
    off[l] = relative > 0 ? 1 : off[l];
  }
  for (int k = 0; k < 3; ++k) LANES {
      const double x = B[i][k][l], y = B[j][k][l], v = V[i][k][l], w = V[j][k][l];
      B[i][k][l] = cs[l] * x - sn[l] * y;
      B[j][k][l] = sn[l] * x + cs[l] * y;
      V[i][k][l] = cs[l] * v - sn[l] * w;
      V[j][k][l] = sn[l] * v + cs[l] * w;
    }
}

static void order(double B[3][3][W], double V[3][3][W], double n[3][W], int i, int j) {
  double swap[W];
  LANES swap[l] = n[i][l] < n[j][l] ? 1 : 0;
  for (int k = 0; k < 3; ++k) LANES {
      const double x = B[i][k][l], y = B[j][k][l], v = V[i][k][l], w = V[j][k][l];
      B[i][k][l] = swap[l] > 0 ? y : x;
      B[j][k][l] = swap[l] > 0 ? -x : y; /* the sign keeps V a rotation */
      V[i][k][l] = swap[l] > 0 ? w : v;
      V[j][k][l] = swap[l] > 0 ? -v : w;
    }
  LANES {
    const double x = n[i][l], y = n[j][l];
    n[i][l] = swap[l] > 0 ? y : x;
    n[j][l] = swap[l] > 0 ? x : y;
  }
}

/* One-sided Jacobi: columns of B = F V made orthogonal. U, V are [column][row][lane]. */
static void singular_values(double F[DD][W], double U[3][3][W], double s[3][W], double V[3][3][W]) {
  double B[3][3][W], n[3][W], off[W];
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) LANES {
        B[i][k][l] = F[3 * k + i][l];
        V[i][k][l] = i == k;
      }
  for (int sweep = 0; sweep < 12; ++sweep) {
    double any = 0;
    LANES off[l] = 0;
    rotate(B, V, 0, 1, off);
    rotate(B, V, 0, 2, off);
    rotate(B, V, 1, 2, off);
    LANES any += off[l];
    if (any == 0) break;
  }
  for (int i = 0; i < 3; ++i)
    LANES n[i][l] = sqrt(B[i][0][l] * B[i][0][l] + B[i][1][l] * B[i][1][l] + B[i][2][l] * B[i][2][l]);
  order(B, V, n, 0, 1);
  order(B, V, n, 0, 2);
  order(B, V, n, 1, 2);
  for (int i = 0; i < 2; ++i)
    for (int k = 0; k < 3; ++k) LANES U[i][k][l] = B[i][k][l] / (n[i][l] > 0 ? n[i][l] : 1);
  LANES { /* ranks zero and one leave U open: take what makes R = U V^T nearest to where it was free */
    if (n[0][l] == 0) {
      for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) U[i][k][l] = V[i][k][l];
    } else if (n[1][l] <= 1e-290 || n[1][l] < 1e-30 * n[0][l]) {
      int small = 0;
      for (int k = 1; k < 3; ++k)
        if (fabs(U[0][k][l]) < fabs(U[0][small][l])) small = k;
      double other[3], length = 0;
      for (int k = 0; k < 3; ++k) other[k] = (k == small) - U[0][small][l] * U[0][k][l];
      for (int k = 0; k < 3; ++k) length += other[k] * other[k];
      for (int k = 0; k < 3; ++k) U[1][k][l] = other[k] / sqrt(length);
    }
  }
  for (int k = 0; k < 3; ++k) LANES {
      const int a = (k + 1) % 3, b = (k + 2) % 3;
      U[2][k][l] = U[0][a][l] * U[1][b][l] - U[0][b][l] * U[1][a][l];
    }
  LANES {
    s[0][l] = n[0][l];
    s[1][l] = n[1][l];
    s[2][l] = U[2][0][l] * B[2][0][l] + U[2][1][l] * B[2][1][l] + U[2][2][l] * B[2][2][l];
  }
}
#else
#define LANES for (int l = 0; l < W; ++l)

static void singular_values(double F[DD][W], double U[2][2][W], double s[2][W], double V[2][2][W]) {
  LANES {
    const double a = F[0][l], b = F[1][l], c = F[2][l], d = F[3][l];
    const double x = 0.5 * (a + d), y = 0.5 * (c - b), u = 0.5 * (a - d), v = 0.5 * (c + b);
    const double first = hypot(x, y) + hypot(u, v);
    const double plus = atan2(y, x), minus = atan2(v, u);
    const double left = 0.5 * (plus + minus), right = 0.5 * (minus - plus);
    s[0][l] = first;
    s[1][l] = first > 0 ? (a * d - b * c) / first : 0;
    U[0][0][l] = cos(left);
    U[0][1][l] = sin(left);
    U[1][0][l] = -U[0][1][l];
    U[1][1][l] = U[0][0][l];
    V[0][0][l] = cos(right);
    V[0][1][l] = sin(right);
    V[1][0][l] = -V[0][1][l];
    V[1][1][l] = V[0][0][l];
  }
}
#endif

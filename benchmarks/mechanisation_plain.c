/* The arithmetic of sinstool.methods.strapdown.navigation.step in plain C: what it costs at the least.
 *
 * state: latitude, longitude, height, v_n (3), q_nb (4); one update per row of phi and dv.
 * With baro_every > 0 a third-order loop holds the height: the correction A acts at every update,
 * the gains at every baro_every-th one.
 */
#include <math.h>

static const double A = 6378137.0, E2 = 6.69437999014131699614e-3, RATE = 7.292115e-5;
static const double GAMMA = 9.7803253359, SOMIGLIANA = 0.00193185265241;
static const double F = 1.0 / 298.257223563, M = 0.00344978650684, NORTH = -1.616e-8;

static void far_turn(double s, double c, double tn, double te, double way, double *r)
{
    double angle = sqrt(way), f, k;
    if (angle < 1e-4) {
        f = 1.0 - way / 6.0;
        k = 0.5 - way / 24.0;
    } else {
        double g = sin(0.5 * angle) / angle;
        f = sin(angle) / angle;
        k = 2.0 * g * g;
    }
    double up_n = -te * f, up_e = tn * f, ca = 1.0 - k * way;
    double up_x = ca * c - up_n * s, up_z = ca * s + up_n * c;
    double turn = atan2(up_e, up_x), st = sin(turn), ct = cos(turn), mixed = k * tn * te;
    r[0] = atan2(up_z, hypot(up_x, up_e));
    r[1] = turn;
    r[2] = (s * (1.0 - k * te * te) + c * up_n) * st + mixed * ct;
    r[3] = (s * mixed + c * up_e) * st + (1.0 - k * tn * tn) * ct;
}

static void step(double *state, double px, double py, double pz, double ux, double uy, double uz,
                 double dt, double correction)
{
    double lat = state[0], h = state[2], vn = state[3], ve = state[4], vd = state[5];
    double w = state[6], x = state[7], y = state[8], z = state[9];
    double s = sin(lat), c = cos(lat), half = 0.5 * dt;

    double north = half * vn / A, sm = s + c * north, cm = c - s * north, hm = h - half * vd;
    double s2 = sm * sm, e = 1.0 - E2 * s2, root = sqrt(e);
    double rn = root / (A + hm * root), rm = e * root / (A * (1.0 - E2) + hm * e * root);
    double rel = hm / A;
    double gd = GAMMA * (1.0 + SOMIGLIANA * s2) / root
                * (1.0 - (2.0 / A * (1.0 + F + M) - 4.0 / A * F * s2) * hm + 3.0 * rel * rel)
                + correction;
    double gn = NORTH * hm * sm * cm;
    double on = RATE * cm, oe = -RATE * s * (half * ve * rn), od = -RATE * sm;

    double tx = 2.0 * (y * uz - z * uy), ty = 2.0 * (z * ux - x * uz), tz = 2.0 * (x * uy - y * ux);
    double fn = ux + w * tx + (y * tz - z * ty);
    double fe = uy + w * ty + (z * tx - x * tz);
    double fd = uz + w * tz + (x * ty - y * tx);

    double an = 2.0 * on + ve * rn, ae = 2.0 * oe - vn * rm, ad = 2.0 * od;
    double mn = vn + 0.5 * fn + half * (gn - (ae * vd - ad * ve));
    double me = ve + 0.5 * fe - half * (ad * vn - an * vd);
    double md = vd + 0.5 * fd + half * (gd - (an * ve - ae * vn));
    double tn = me * rn, te = -mn * rm;
    an = 2.0 * on + tn;
    ae = 2.0 * oe + te;
    double zn = half * (on + tn), ze = half * (oe + te), zd = half * od;
    double wn = vn + fn - (ze * fd - zd * fe) + dt * (gn - (ae * md - ad * me));
    double we = ve + fe - (zd * fn - zn * fd) - dt * (ad * mn - an * md);
    double wd = vd + fd - (zn * fe - ze * fn) + dt * (gd - (an * me - ae * mn));

    tn = half * (ve + we) * rn;
    te = -half * (vn + wn) * rm;
    double way = tn * tn + te * te, up_x = c * (1.0 - 0.5 * way) + s * te;
    double new_lat, turn, sa, ca, hw, hz;
    if (fabs(tn) < 1e-4 * up_x && way < 1e-8) {
        double f = 1.0 - way / 6.0, up_n = -te * f, up_e = tn * f;
        up_x = c * (1.0 - 0.5 * way) - s * up_n;
        double t = up_e / up_x, t2 = t * t;
        turn = t - t * t2 / 3.0;
        double sl = up_n - 0.5 * s * up_e * t * (1.0 - 0.25 * t2);
        new_lat = lat + sl + sl * sl * sl / 6.0;
        sa = (s * (1.0 - 0.5 * te * te) + up_n * c) * t * (1.0 - 0.5 * t2) + 0.5 * tn * te;
        ca = 1.0 - 0.5 * sa * sa;
        hw = 1.0 - 0.125 * sa * sa;
        hz = 0.5 * sa * (1.0 + 0.125 * sa * sa);
    } else {
        double r[4];
        far_turn(s, c, tn, te, way, r);
        new_lat = r[0];
        turn = r[1];
        sa = r[2];
        ca = r[3];
        double a = 0.5 * atan2(sa, ca);
        hw = cos(a);
        hz = sin(a);
    }
    double lon = state[1] + turn;
    while (lon > M_PI) lon -= 2.0 * M_PI;
    while (lon <= -M_PI) lon += 2.0 * M_PI;
    state[0] = new_lat;
    state[1] = lon;
    state[2] = h - half * (vd + wd);
    state[3] = ca * wn - sa * we;
    state[4] = sa * wn + ca * we;
    state[5] = wd;

    double square = px * px + py * py + pz * pz, qw, f;
    if (square < 1e-2) {
        double u = 0.25 * square;
        qw = 1.0 - u * (0.5 - u * (1.0 / 24.0 - u * (1.0 / 720.0 - u * (1.0 / 40320.0))));
        f = 0.5 - u * (1.0 / 12.0 - u * (1.0 / 240.0 - u * (1.0 / 10080.0 - u * (1.0 / 725760.0))));
    } else {
        double angle = sqrt(square);
        f = sin(0.5 * angle) / angle;
        qw = cos(0.5 * angle);
    }
    double qx = f * px, qy = f * py, qz = f * pz;
    double bw = w * qw - x * qx - y * qy - z * qz, bx = w * qx + x * qw + y * qz - z * qy;
    double by = w * qy - x * qz + y * qw + z * qx, bz = w * qz + x * qy - y * qx + z * qw;
    zn = -0.5 * (dt * on + tn);
    ze = -0.5 * (dt * oe + te);
    zd = -0.5 * dt * od;
    square = zn * zn + ze * ze + zd * zd;
    f = 1.0 - square / 6.0 * (1.0 - 0.05 * square);
    double zw = 1.0 - 0.5 * square * (1.0 - square / 12.0);
    zn *= f;
    ze *= f;
    zd *= f;
    double ew = hw * zw - hz * zd, ex = hw * zn - hz * ze;
    double ey = hw * ze + hz * zn, ez = hw * zd + hz * zw;
    w = ew * bw - ex * bx - ey * by - ez * bz;
    x = ew * bx + ex * bw + ey * bz - ez * by;
    y = ew * by - ex * bz + ey * bw + ez * bx;
    z = ew * bz + ex * by - ey * bx + ez * bw;
    f = 1.5 - 0.5 * (w * w + x * x + y * y + z * z);
    state[6] = w * f;
    state[7] = x * f;
    state[8] = y * f;
    state[9] = z * f;
}

void navigate(double *state, const double *phi, const double *dv, const double *dt, long n,
              long baro_every, const double *baro, const double *gains, double *out)
{
    double correction = 0.0;
    for (long k = 0; k < n; k++) {
        const double *p = phi + 3 * k, *u = dv + 3 * k;
        step(state, p[0], p[1], p[2], u[0], u[1], u[2], dt[k], correction);
        if (baro_every > 0 && (k + 1) % baro_every == 0) {
            double e = state[2] - baro[k];
            state[2] -= gains[0] * e;
            state[5] += gains[1] * e;
            correction += gains[2] * e;
        }
        for (int i = 0; i < 10; i++) out[10 * k + i] = state[i];
    }
}

/* The n-rod pendulum by RK-Gill on W chains side by side, by hand: what C with lanes reaches. Usage: chain_lanes RODS STEPS */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#ifndef W
#define W 8
#endif
#define FL for(int l=0;l<W;l++)
typedef double V[W];
static int n; static double m=1,L=1,g=9.81,J; static V *Od,*r,*P,*C;
/* Cody-Waite sincos, branch free, |x| < 1e5 */
static inline void sc(const double*restrict x,double*restrict c,double*restrict s){
 FL{ double k=nearbyint(x[l]*0.63661977236758134308); double y=x[l]-k*1.5707963267341256e+00; y-=k*6.0771005065061922e-11; y-=k*2.0222662487959506e-21;
  double z=y*y; double ps=y+y*z*(-1.66666666666666324348e-01+z*(8.33333333332248946124e-03+z*(-1.98412698298579493134e-04+z*(2.75573137070700676789e-06+z*(-2.50507602534068634195e-08+z*1.58969099521155010221e-10)))));
  double pc=1-0.5*z+z*z*(4.16666666666666019037e-02+z*(-1.38888888888741095749e-03+z*(2.48015872894767294178e-05+z*(-2.75573143513906633035e-07+z*(2.08757232129817482790e-09-z*1.13596475577881948265e-11)))));
  int q=(int)k; double a=(q&1)?pc:ps, b=(q&1)?ps:pc; s[l]=(q&2)?-a:a; c[l]=((q+1)&2)?-b:b; }
}
static void accel(const V*restrict q,const V*restrict v,V*restrict a){
 double h=.5*L,im=1/m,iJ=1/J;
 for(int i=0;i<n;i++) sc(q[3*i+2],C[2*i],C[2*i+1]);
 for(int i=0;i<n;i++){
  double *restrict pp=P[3*i],*restrict pq=P[3*i+1],*restrict pr=P[3*i+2];
  FL{ double c=C[2*i][l],s=C[2*i+1][l],dx=s*h,dy=-c*h,a00=im+dx*dx*iJ,a01=dx*dy*iJ,a11=im+dy*dy*iJ,w=v[3*i+2][l],w2=w*w,g0=-w2*c*h,g1=-w2*s*h,f1=-g;
   double r0,r1;
   if(i){double cp=C[2*i-2][l],sp=C[2*i-1][l],ex=sp*h,ey=-cp*h; a00+=im+ex*ex*iJ;a01+=ex*ey*iJ;a11+=im+ey*ey*iJ;double wp=v[3*i-1][l];g0+=-wp*wp*cp*h;g1+=-wp*wp*sp*h;f1+=g;
    double o00=-im+ex*ex*iJ,o01=ex*ey*iJ,o11=-im+ey*ey*iJ; Od[3*i][l]=o00;Od[3*i+1][l]=o01;Od[3*i+2][l]=o11;
    double p00=P[3*i-3][l],p01=P[3*i-2][l],p11=P[3*i-1][l];
    double w00=o00*p00+o01*p01,w01=o00*p01+o01*p11,w10=o01*p00+o11*p01,w11=o01*p01+o11*p11;
    a00-=w00*o00+w01*o01;a01-=w00*o01+w01*o11;a11-=w10*o01+w11*o11;
    r0=0-g0-(w00*r[2*i-2][l]+w01*r[2*i-1][l]); r1=f1-g1-(w10*r[2*i-2][l]+w11*r[2*i-1][l]);
   } else {r0=-g0;r1=f1-g1;}
   r[2*i][l]=r0;r[2*i+1][l]=r1;
   double id=1/(a00*a11-a01*a01);pp[l]=a11*id;pq[l]=-a01*id;pr[l]=a00*id; }
 }
 V l0,l1; FL{l0[l]=0;l1[l]=0;}
 for(int i=n-1;i>=0;i--){ FL{ double x0=r[2*i][l],x1=r[2*i+1][l]; double n0=l0[l],n1=l1[l];
  if(i<n-1){x0-=Od[3*i+3][l]*n0+Od[3*i+4][l]*n1;x1-=Od[3*i+4][l]*n0+Od[3*i+5][l]*n1;}
  double L0=P[3*i][l]*x0+P[3*i+1][l]*x1,L1=P[3*i+1][l]*x0+P[3*i+2][l]*x1; l0[l]=L0;l1[l]=L1;
  double c=C[2*i][l],s=C[2*i+1][l]; a[3*i][l]=(n0-L0)*im;a[3*i+1][l]=(n1-L1)*im-g;a[3*i+2][l]=-(s*h*(L0+n0)-c*h*(L1+n1))*iJ; }
 }
}
int main(int ac,char**av){ n=atoi(av[1]); int N=atoi(av[2]); J=m*L*L/12; Od=aligned_alloc(64,sizeof(V)*3*n);r=aligned_alloc(64,sizeof(V)*2*n);P=aligned_alloc(64,sizeof(V)*3*n);C=aligned_alloc(64,sizeof(V)*2*n);
 V *y=aligned_alloc(64,sizeof(V)*6*n),*k=aligned_alloc(64,sizeof(V)*6*n),*Q=aligned_alloc(64,sizeof(V)*6*n); memset(y,0,sizeof(V)*6*n);memset(Q,0,sizeof(V)*6*n); for(int i=0;i<n;i++)FL y[3*i][l]=.5+i;
 double A[4]={.5,1-sqrt(.5),1+sqrt(.5),1/6.},B[4]={2,1,1,2},Cc[4]={.5,1-sqrt(.5),1+sqrt(.5),.5}; double h=0.01/(n>4?10:1);
 struct timespec t0,t1;clock_gettime(CLOCK_MONOTONIC,&t0);
 for(int it=0;it<N;it++)for(int st=0;st<4;st++){accel(y,y+3*n,k+3*n);memcpy(k,y+3*n,sizeof(V)*3*n);for(int j=0;j<6*n;j++)FL{double R=A[st]*(k[j][l]-B[st]*Q[j][l]);y[j][l]+=h*R;Q[j][l]+=3*R-Cc[st]*k[j][l];}}
 clock_gettime(CLOCK_MONOTONIC,&t1); double dt=(t1.tv_sec-t0.tv_sec)+1e-9*(t1.tv_nsec-t0.tv_nsec);
 printf("W=%d n=%d ns/eval/body/member %.2f us/step/member %.4f (y0 %.6g)\n",W,n,dt/(4.0*N*n*W)*1e9,dt/N*1e6/W,y[0][0]);}

/* The n-rod pendulum by RK-Gill, chain-only, by hand: what C reaches on this machine. Usage: chain_limit RODS STEPS */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
static int n; static double m=1,L=1,g=9.81,J; static double *Dd,*Od,*r,*lam,*P,*C;
static void accel(const double*restrict q,const double*restrict v,double*restrict a){
 double h=.5*L,im=1/m,iJ=1/J;
 for(int i=0;i<n;i++){sincos(q[3*i+2],&C[2*i+1],&C[2*i]);}
 for(int i=0;i<n;i++){
  double c=C[2*i],s=C[2*i+1],dx=s*h,dy=-c*h,a00=im+dx*dx*iJ,a01=dx*dy*iJ,a11=im+dy*dy*iJ,w=v[3*i+2],w2=w*w,g0=-w2*c*h,g1=-w2*s*h,f1=-g;
  if(i){double cp=C[2*i-2],sp=C[2*i-1],ex=sp*h,ey=-cp*h; a00+=im+ex*ex*iJ;a01+=ex*ey*iJ;a11+=im+ey*ey*iJ;double wp=v[3*i-1];g0+=-wp*wp*cp*h;g1+=-wp*wp*sp*h;f1+=g;
   double o00=-im+ex*ex*iJ,o01=ex*ey*iJ,o11=-im+ey*ey*iJ; Od[3*i]=o00;Od[3*i+1]=o01;Od[3*i+2]=o11;
   double p00=P[3*i-3],p01=P[3*i-2],p11=P[3*i-1];
   double w00=o00*p00+o01*p01,w01=o00*p01+o01*p11,w10=o01*p00+o11*p01,w11=o01*p01+o11*p11;
   a00-=w00*o00+w01*o01;a01-=w00*o01+w01*o11;a11-=w10*o01+w11*o11;
   r[2*i]=0-g0-(w00*r[2*i-2]+w01*r[2*i-1]); r[2*i+1]=f1-g1-(w10*r[2*i-2]+w11*r[2*i-1]);
  } else {r[0]=-g0;r[1]=f1-g1;}
  double id=1/(a00*a11-a01*a01);P[3*i]=a11*id;P[3*i+1]=-a01*id;P[3*i+2]=a00*id;
 }
 double l0=0,l1=0;
 for(int i=n-1;i>=0;i--){double x0=r[2*i],x1=r[2*i+1]; double n0=l0,n1=l1;
  if(i<n-1){x0-=Od[3*i+3]*l0+Od[3*i+4]*l1;x1-=Od[3*i+4]*l0+Od[3*i+5]*l1;}
  l0=P[3*i]*x0+P[3*i+1]*x1;l1=P[3*i+1]*x0+P[3*i+2]*x1;
  double c=C[2*i],s=C[2*i+1]; a[3*i]=(n0-l0)*im;a[3*i+1]=(n1-l1)*im-g;a[3*i+2]=-(s*h*(l0+n0)-c*h*(l1+n1))*iJ;
 }
}
int main(int ac,char**av){ n=atoi(av[1]); int N=atoi(av[2]); J=m*L*L/12; Dd=calloc(4*n,8);Od=calloc(3*n,8);r=calloc(2*n,8);lam=calloc(2*n,8);P=calloc(3*n,8);C=calloc(2*n,8);
 double *y=calloc(6*n,8),*k=calloc(6*n,8),*Q=calloc(6*n,8); for(int i=0;i<n;i++)y[3*i]=.5+i;
 double A[4]={.5,1-sqrt(.5),1+sqrt(.5),1/6.},B[4]={2,1,1,2},Cc[4]={.5,1-sqrt(.5),1+sqrt(.5),.5}; double h=0.01/(n>4?10:1);
 struct timespec t0,t1;clock_gettime(CLOCK_MONOTONIC,&t0);
 for(int it=0;it<N;it++)for(int st=0;st<4;st++){accel(y,y+3*n,k+3*n);memcpy(k,y+3*n,24*n);for(int j=0;j<6*n;j++){double R=A[st]*(k[j]-B[st]*Q[j]);y[j]+=h*R;Q[j]+=3*R-Cc[st]*k[j];}}
 clock_gettime(CLOCK_MONOTONIC,&t1); double dt=(t1.tv_sec-t0.tv_sec)+1e-9*(t1.tv_nsec-t0.tv_nsec);
 printf("n=%d %.3f ms ns/eval/body %.1f us/step %.3f (y0 %.6g)\n",n,dt*1e3,dt/(4.0*N*n)*1e9,dt/N*1e6,y[0]);}

// Example 1 in hand-written C++: adaptive Tsit5 in physical coordinates, no supremum tracked. For speed alone.
// g++ -Ofast -march=native -fopenmp-simd -mprefer-vector-width=512 tsit5.cpp -o tsit5 -lmvec -lm -pthread && ./tsit5 9984 2 1e-6   (-DF32 for float32)
// adaptive Tsit5 for example 1, blocks of W lanes, each lane its own t and h (masked), vectorised by gcc + libmvec
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>
#include <thread>
#include <chrono>
#include <algorithm>
constexpr int W=32;
#ifdef F32
typedef float R;
#else
typedef double R;
#endif
static inline __attribute__((always_inline)) void rhs(const R*__restrict t,const R*__restrict x0,const R*__restrict x1,const R*__restrict a,R*__restrict k0,R*__restrict k1){
  R ST_[W],CT_[W];
  #pragma omp simd
  for(int i=0;i<W;i++) ST_[i]=std::sin(t[i]);
  asm volatile("":::"memory");
  #pragma omp simd
  for(int i=0;i<W;i++) CT_[i]=std::cos(t[i]);
  #pragma omp simd
  for(int i=0;i<W;i++){
    R st=ST_[i],ct=CT_[i];
    R rho=R(4)*std::exp(R(-3)*t[i])+R(.05);
    R s=R(2)*(x0[i]-st)+x1[i]-ct;
    R u=-std::tan(R(M_PI/2)*s/rho);
    k0[i]=x1[i];
    k1[i]=-std::sin(x0[i])-x1[i]+std::sin(x1[i])+u*R(1/(0.01*9.8*9.8))+a[i]*st;
  }
}
// Tsit5
constexpr double c2=0.161,c3=0.327,c4=0.9,c5=0.9800255409045097;
constexpr double a21=0.161,a31=-0.008480655492356989,a32=0.335480655492357,a41=2.8971530571054935,a42=-6.359448489975075,a43=4.3622954328695815,a51=5.325864828439257,a52=-11.748883564062828,a53=7.4955393428898365,a54=-0.09249506636175525,a61=5.86145544294642,a62=-12.92096931784711,a63=8.159367898576159,a64=-0.071584973281401,a65=-0.028269050394068383;
constexpr double b1=0.09646076681806523,b2=0.01,b3=0.4798896504144996,b4=1.379008574103742,b5=-3.290069515436081,b6=2.324710524099774;
constexpr double e1=-0.00178001105222577714,e2=-0.0008164344596567469,e3=0.007880878010261995,e4=-0.1447110071732629,e5=0.5823571654525552,e6=-0.45808210592918697,e7=0.015151515151515152;
static long block(R*X0,R*X1,const R*A,R T,R rtol,R atol,long*steps){
  R t[W],h[W],k[7][2][W],y0[W],y1[W],tt[W],n0[W],n1[W];
  for(int i=0;i<W;i++){t[i]=0;h[i]=R(.01);y0[i]=X0[i];y1[i]=X1[i];}
  rhs(t,y0,y1,A,k[0][0],k[0][1]);
  long it=0; 
  while(true){
    it++;
    for(int i=0;i<W;i++) h[i]=std::min(h[i],T-t[i]);
#define ST(c,EX0,EX1,J) _Pragma("omp simd") for(int i=0;i<W;i++){tt[i]=t[i]+R(c)*h[i];n0[i]=y0[i]+h[i]*(EX0);n1[i]=y1[i]+h[i]*(EX1);} rhs(tt,n0,n1,A,k[J][0],k[J][1]);
#define K(j,q) k[j][q][i]
    ST(c2,R(a21)*K(0,0),R(a21)*K(0,1),1)
    ST(c3,R(a31)*K(0,0)+R(a32)*K(1,0),R(a31)*K(0,1)+R(a32)*K(1,1),2)
    ST(c4,R(a41)*K(0,0)+R(a42)*K(1,0)+R(a43)*K(2,0),R(a41)*K(0,1)+R(a42)*K(1,1)+R(a43)*K(2,1),3)
    ST(c5,R(a51)*K(0,0)+R(a52)*K(1,0)+R(a53)*K(2,0)+R(a54)*K(3,0),R(a51)*K(0,1)+R(a52)*K(1,1)+R(a53)*K(2,1)+R(a54)*K(3,1),4)
    ST(1,R(a61)*K(0,0)+R(a62)*K(1,0)+R(a63)*K(2,0)+R(a64)*K(3,0)+R(a65)*K(4,0),R(a61)*K(0,1)+R(a62)*K(1,1)+R(a63)*K(2,1)+R(a64)*K(3,1)+R(a65)*K(4,1),5)
    ST(1,R(b1)*K(0,0)+R(b2)*K(1,0)+R(b3)*K(2,0)+R(b4)*K(3,0)+R(b5)*K(4,0)+R(b6)*K(5,0),R(b1)*K(0,1)+R(b2)*K(1,1)+R(b3)*K(2,1)+R(b4)*K(3,1)+R(b5)*K(4,1)+R(b6)*K(5,1),6)
    R alive=0;
    #pragma omp simd reduction(+:alive)
    for(int i=0;i<W;i++){
      R E0=h[i]*(R(e1)*K(0,0)+R(e2)*K(1,0)+R(e3)*K(2,0)+R(e4)*K(3,0)+R(e5)*K(4,0)+R(e6)*K(5,0)+R(e7)*K(6,0));
      R E1=h[i]*(R(e1)*K(0,1)+R(e2)*K(1,1)+R(e3)*K(2,1)+R(e4)*K(3,1)+R(e5)*K(4,1)+R(e6)*K(5,1)+R(e7)*K(6,1));
      R s0=atol+rtol*std::max(std::fabs(y0[i]),std::fabs(n0[i])),s1=atol+rtol*std::max(std::fabs(y1[i]),std::fabs(n1[i]));
      E0/=s0;E1/=s1;
      R err=std::sqrt(R(.5)*(E0*E0+E1*E1))+R(1e-10);
      bool ok=err<=R(1);
      R fac=R(.9)*std::exp(R(-.2)*std::log(err)); fac=std::min(R(10),std::max(R(.2),fac));
      if(!ok) fac=std::min(fac,R(1));
      t[i]=ok?t[i]+h[i]:t[i]; y0[i]=ok?n0[i]:y0[i]; y1[i]=ok?n1[i]:y1[i];
      K(0,0)=ok?K(6,0):K(0,0);K(0,1)=ok?K(6,1):K(0,1);
      h[i]*=fac;
      alive+= (t[i]<T-R(1e-6))?R(1):R(0);
    }
    if(alive==0||it>1000000)break;
  }
  for(int i=0;i<W;i++){X0[i]=y0[i];X1[i]=y1[i];}
  *steps+=it; return it;
}
int main(int c,char**v){
  int N=atoi(v[1]),P=c>2?atoi(v[2]):2; R rtol=c>3?atof(v[3]):1e-6,atol=rtol*R(1e-2);
  std::vector<R> x0(N),x1(N),a(N); srand(1);
  for(int r=0;r<4;r++){
  for(int i=0;i<N;i++){x0[i]=.1+.8*rand()/RAND_MAX;x1[i]=.1+.8*rand()/RAND_MAX;a[i]=-.5+1.*rand()/RAND_MAX;}
  long st[64]={0};
  auto b=std::chrono::steady_clock::now();
  std::vector<std::thread> th; for(int p=0;p<P;p++) th.emplace_back([&,p]{for(int i=p*W;i+W<=N;i+=P*W)block(&x0[i],&x1[i],&a[i],R(20),rtol,atol,&st[p]);}); for(auto&q:th)q.join();
  double s=std::chrono::duration<double>(std::chrono::steady_clock::now()-b).count();
  long S=0;for(int p=0;p<P;p++)S+=st[p];
  printf("N=%d P=%d %.4fs %.0f traj/s mean lockstep steps %.0f  ns/step/traj %.1f  x=%.8f\n",N,P,s,N/s,double(S)*W/N,s*1e9/(double(S)*W),(double)x0[0]);
  }
}

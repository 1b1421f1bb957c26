#include "palpate/devices/simulated/virtual_arm.h"

#include <limits>

#include "palpate/devices/simulated/simulated_device.h"

namespace palpate {
namespace {

constexpr double kRate = 1000.0;  // [Hz]

class VirtualArm final : public Arm {
 public:
  VirtualArm()
      : arm_(params_, GripParams{0.0, 0.0},
             {[](double) { return Vec3(Vec3::Zero()); }, std::numeric_limits<double>::max()},
             kRate),
        info_(arm_.info()) {
    info_.name = "the virtual arm";
    traits_.input_rate = kRate;
    traits_.stiffness = info_.max_stiffness;
    traits_.workspace_radius = info_.workspace_radius;
  }
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override { return arm_.read(); }
  void write(const Vec3& force) noexcept override {
    arm_.write(force);
    ++traffic_.writes;
  }
  [[nodiscard]] const ArmTraits& traits() const noexcept override { return traits_; }
  [[nodiscard]] std::string whyNotReady() const override { return ""; }
  [[nodiscard]] std::vector<double> steps() const override {
    return {params_.encoder, params_.encoder, params_.encoder};
  }
  [[nodiscard]] ArmTraffic traffic() const override { return traffic_; }

 private:
  ArmParams params_;
  SimulatedDevice arm_;
  DeviceInfo info_;
  ArmTraits traits_;
  ArmTraffic traffic_;
};

}  // namespace

std::unique_ptr<Arm> makeVirtualArm() {
  return std::make_unique<VirtualArm>();
}

}  // namespace palpate

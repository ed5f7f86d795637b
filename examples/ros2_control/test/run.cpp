// Activate the controller, update it, and let a sensor drop out.
#include <cmath>

#include "stubs.hpp"

extern "C" controller_interface::ControllerInterface * made();

int main()
{
  using controller_interface::CallbackReturn;
  using controller_interface::return_type;
  auto * controller = made();
  const auto update = [&] {return controller->update({}, {});};
  controller->rate = 500;
  if (controller->on_activate({}) != CallbackReturn::ERROR) {return 1;}
  controller->rate = 1000;
  controller->state_interfaces_[0].value = 0.5;
  if (controller->on_activate({}) != CallbackReturn::SUCCESS || update() != return_type::OK) {return 2;}
  const double torque = controller->command_interfaces_[0].value;
  if (!(std::abs(torque) > 1.0 && std::abs(torque) <= 500.0)) {return 3;}  // gravity is held
  controller->state_interfaces_[1].value = NAN;
  for (int k = 0; k < 5; ++k) {
    if (update() != return_type::OK || controller->command_interfaces_[0].value != torque) {return 4;}
  }
  return update() == return_type::ERROR ? 0 : 5;
}
